"""From readings of the deflection to its rate and acceleration, as far as they can be known."""
