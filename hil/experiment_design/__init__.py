"""Predict the standard errors of an excitation before the motor moves."""
