"""The driver of CiA 402 drives on CANopen: EPOS4, EPOS2 and drives with the plain profile."""
