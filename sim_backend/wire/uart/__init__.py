"""Emulated serial lines."""
