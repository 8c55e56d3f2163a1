"""The parts of one fit: bounds of its search, exact optimum, validation, and whether it describes the recording."""
