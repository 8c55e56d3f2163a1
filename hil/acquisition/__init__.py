"""Drive an excitation against the locked joint and record what comes back."""
