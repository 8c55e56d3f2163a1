"""Request and reply packets on a half-duplex serial line, which DYNAMIXEL and Feetech servos share."""
