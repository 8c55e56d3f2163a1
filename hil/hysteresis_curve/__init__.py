"""Stiffness, lost motion, play and loss from the loops of a slow torsion test, as makers of gears define them."""
