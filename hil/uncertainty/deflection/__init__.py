"""The effect of errors of the deflection on the parameters, and the correction for it."""
