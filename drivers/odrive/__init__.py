"""The driver of ODrive axes on CAN, with the protocol CANSimple."""
