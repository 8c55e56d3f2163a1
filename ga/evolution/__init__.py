"""The genetic algorithm: its schemes, operators and population."""
