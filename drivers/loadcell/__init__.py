"""Torque cells that print their readings on a serial port."""
