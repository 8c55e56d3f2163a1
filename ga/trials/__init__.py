"""Independent trials, their checkpoint, and the search over nonlinear parameters."""
