"""Kc and Bc averaged over the models that the data cannot decide between."""
