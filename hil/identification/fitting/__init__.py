"""The parts of one fit: its samples and bounds, the search, the exact optimum, its intervals, and validation."""
