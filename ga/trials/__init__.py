"""Independent trials of a search, their checkpoint, and the search over nonlinear parameters."""
