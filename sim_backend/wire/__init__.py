"""Peers at the other end of a wire: what a drive answers, byte for byte, with the simulator's plant behind it.

Each is written from its protocol's manual and shares neither code nor tables with the adapter it is used to prove.
"""
