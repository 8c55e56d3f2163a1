"""Servos: the one interface (`drivers.servo`) and the drives that speak it, one module a wire protocol."""
