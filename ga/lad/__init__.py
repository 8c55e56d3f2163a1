"""Find the exact minimum of the fitness: least absolute deviations."""
