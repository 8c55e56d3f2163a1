"""Readers of tables in binary files and JSON: one module for each family of formats, over the library that keeps it."""
