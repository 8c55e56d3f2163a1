"""Identify the coupling from one or several recordings: fit a model, and find Kc, Bc and their confidence intervals."""
