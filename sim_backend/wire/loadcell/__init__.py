"""An emulated torque cell."""
