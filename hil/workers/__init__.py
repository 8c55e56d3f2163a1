"""Distribute work over processes of this computer."""
