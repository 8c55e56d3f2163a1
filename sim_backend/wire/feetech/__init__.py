"""Emulated Feetech STS, HLS and SCS servos."""
