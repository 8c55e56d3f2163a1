"""An emulated CANopen node."""
