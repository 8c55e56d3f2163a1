"""Access to a CAN bus, on which several drives may be connected."""
