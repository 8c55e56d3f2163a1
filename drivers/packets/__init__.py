"""Request and reply packets on a half-duplex serial line, which several families of servos share."""
