"""Confidence intervals, and whether they may be trusted."""
