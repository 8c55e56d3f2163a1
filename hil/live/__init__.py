"""The live view of a run: what its rows show so far, drawn by a separate process."""
