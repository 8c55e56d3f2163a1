"""Model selection: the terms that a recording pays for, and other models of a late torque reading."""
