"""The checks of `hil doctor`: the link, the drive, the torque-off, the signs of the readings, and the lock of the
joint.
"""
