"""The live view of a run: a separate process draws the rows recorded so far."""
