"""Emulated CubeMars AK and Damiao motors."""
