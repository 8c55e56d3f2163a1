"""The parts of one fit: bounds of the search, exact optimum, validation, and the lack-of-fit test."""
