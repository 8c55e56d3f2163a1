"""CiA 402 drives on CANopen: EPOS4, EPOS2 and the plain profile."""
