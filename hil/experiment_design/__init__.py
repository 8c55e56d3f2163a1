"""Predict the standard errors of Kc and Bc for an excitation before the motor moves."""
