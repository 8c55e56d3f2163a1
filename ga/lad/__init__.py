"""The exact minimum of the fitness: least absolute deviations."""
