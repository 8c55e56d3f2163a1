"""The live view of a run: what its rows say so far, drawn by a process of its own."""
