"""The drivers of servos: their interface (`drivers.servo`), the safety gate (`drivers.gate`) and a sub-package for each
protocol.
"""
