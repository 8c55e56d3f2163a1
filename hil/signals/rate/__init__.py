"""From readings of the deflection to its rate and acceleration, where they can be known."""
