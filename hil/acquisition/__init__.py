"""Drive an excitation against the locked joint and record the drive's readings."""
