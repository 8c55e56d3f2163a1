"""The genetic search for a model's parameters: chromosomes, operators, fitness, trials, and the exact optimum beside
them.
"""
