"""Compute rate and acceleration from readings of the deflection, where they can be known."""
