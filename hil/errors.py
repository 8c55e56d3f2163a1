"""The two ways a command can decline; drives have their own (`drivers.servo.DriverError`)."""


class WrongUse(Exception):
    """The request cannot be carried out: the message says what is wrong, where, and what to do (exit status 2)."""


class Untrustworthy(Exception):
    """The data is there and was read, but no result drawn from it could be trusted (exit status 1)."""
