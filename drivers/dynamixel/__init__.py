"""DYNAMIXEL X (protocol 2.0) and MX (protocol 1.0) servos."""
