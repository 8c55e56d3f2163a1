"""An emulated half-duplex line of servos that answer packets, which several families share."""
