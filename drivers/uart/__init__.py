"""A serial port and lines of text on it."""
