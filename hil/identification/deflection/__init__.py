"""Compute the effect of errors of the deflection on the parameters, and correct it."""
