"""Compute confidence intervals, and check whether they may be trusted."""
