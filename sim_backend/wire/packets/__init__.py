"""An emulated half-duplex serial line of servos that reply with packets: DYNAMIXEL and Feetech."""
