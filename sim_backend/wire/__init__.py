"""Emulated drives at the other end of a wire: their replies byte for byte, with the simulator's plant at their motors.

Each is written from its protocol's manual and shares neither code nor tables with the adapter it is used to prove.
"""
