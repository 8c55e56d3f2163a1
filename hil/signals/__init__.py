"""Compute torque, deflection and rate from the rows of a recording, and check their quality."""
