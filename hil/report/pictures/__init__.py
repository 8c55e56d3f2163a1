"""Figures of a recording and of an identification, for HTML pages and as PNG files."""
