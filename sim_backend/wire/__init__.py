"""Emulated drives at the other end of a wire. They send the replies of real drives byte for byte; the simulator's plant
is attached to their motors.

Each emulator is written from the manual of its protocol. It shares neither code nor tables with the driver that it
tests.
"""
