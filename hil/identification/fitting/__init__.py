"""The parts of one fit: bounds of the search, exact optimum, validation, and the test whether it describes the
recording.
"""
