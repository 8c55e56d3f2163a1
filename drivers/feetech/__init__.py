"""The driver of Feetech STS, HLS and SCS servos on a serial port."""
