"""Identify the coupling of one or several recordings."""
