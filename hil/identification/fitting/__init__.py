"""The parts of one fit: the bounds of its search, its exact optimum, its validation."""
