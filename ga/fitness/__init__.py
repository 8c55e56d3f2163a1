"""The fitness: mean absolute torque error, evaluated on many rows in little time."""
