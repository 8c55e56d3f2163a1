"""A serial port, and the lines of text that it receives."""
