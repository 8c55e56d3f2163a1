"""The driver of DYNAMIXEL servos: X series (protocol 2.0) and MX series (protocol 1.0)."""
