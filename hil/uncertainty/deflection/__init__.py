"""What errors of the deflection do to the parameters, and the change by which they are corrected."""
