"""The driver of torque cells whose board prints the readings on a serial port."""
