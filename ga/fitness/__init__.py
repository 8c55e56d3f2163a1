"""The fitness: mean absolute torque error, computed quickly for many rows."""
