"""The stand file: how it is defined, which devices it can name, and how a servo is opened from it."""
