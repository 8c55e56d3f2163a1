"""The stand file: its schema, its devices, and the servo that is opened from it."""
