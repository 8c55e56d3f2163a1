"""Readings of a table that a logger wrote without their sign, and stamps without their order or fraction."""
