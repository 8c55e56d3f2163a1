"""Recordings on disk: reading, writing, checking and naming."""
