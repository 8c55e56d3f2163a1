"""Emulated ODrive axes."""
