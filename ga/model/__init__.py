"""The coupling models and their terms."""
