"""ODrive axes on CAN (CANSimple)."""
