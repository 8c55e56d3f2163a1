"""The driver of moteus controllers on CAN FD."""
