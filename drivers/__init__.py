"""Servos: the interface (`drivers.servo`), its safety gate (`drivers.gate`) and one sub-package for each protocol."""
