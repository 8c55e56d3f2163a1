"""Readers of tables in binary files and JSON: one module for each family of formats, which calls the library for these
formats.
"""
