"""The genetic search: chromosomes, operators, fitness, trials, and the exact optimum beside them."""
