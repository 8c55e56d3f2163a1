"""moteus controllers on CAN FD."""
