"""A CAN bus that several drives share."""
