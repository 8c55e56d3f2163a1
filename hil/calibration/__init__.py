"""Calibration of a stand: the torque cell's scale, its delay, and the motor's zero."""
