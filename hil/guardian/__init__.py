"""The guardian: a small process that switches the torque off when the process that drives the motor cannot."""
