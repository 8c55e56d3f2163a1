"""An emulated CAN bus."""
