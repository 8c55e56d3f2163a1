"""CubeMars AK and Damiao motors: MIT frames on CAN."""
