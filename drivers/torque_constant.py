"""Refuse a torque constant that contradicts the maker's table, the drive itself, or every motor that exists.

A constant that is 1000 times too small makes hil command 1000 times the current: the torque limit does not hold.
"""

from __future__ import annotations

from drivers.servo import DriverError

SPREAD = 2.5
"""The largest ratio of a measured torque constant to a stated one: makers' values spread by up to 50 %, and friction
hides torque.
"""
_MOTORS = (4e-4, 1.7)
"""N m/A: the torque constants of motors without a gear, 8.27 divided by 5 to 20,000 rev/min/V."""
_STALLS = (0.2, 20.0)
"""A that a servo with a gear may take at stall."""
_BEYOND = 10.0
"""The largest ratio of the current at the stand's torque limit to the drive's own current limit."""
_EFFECT = "torque limit and Kc would be wrong"


def contradiction(key: str, given: float | None, stated: float, source: str, unit: str = "N m/A") -> str:
    """Return why the value `given` of the stand file's `key` contradicts the value `stated` by `source`; "" if not."""
    if given is None or not stated > 0.0 or 1.0 / SPREAD <= given / stated <= SPREAD:
        return ""
    factor = max(given / stated, stated / given)
    return (
        f"{key} is {given:g} {unit} in the stand file and {stated:.3g} {unit} in {source}, a factor of {factor:.3g}: "
        f"{_EFFECT}; correct {key} (a measured value differs by at most a factor of {SPREAD:g})"
    )


def implausible(key: str, given: float | None) -> str:
    """Return why no motor without a gear has the torque constant `given`, N m/A; "" if one may."""
    low, high = _MOTORS
    if given is None or low <= given <= high:
        return ""
    milli = f'write "{given:g} mN*m/A" if that is meant, or ' if low <= 1e-3 * given <= high else ""
    return (
        f"{key} is {given:g} N m/A, and motors without a gear have {low:g} to {high:g} N m/A: {_EFFECT}; {milli}take "
        "it from the data sheet, or 8.27 divided by the motor's KV in rev/min/V"
    )


def implausible_stall(key: str, given: float | None, stall: float, model: str) -> str:
    """Return why a servo with the stall torque `stall`, N m, cannot have the torque constant `given`; "" if it may."""
    low, high = _STALLS
    if given is None or low <= stall / given <= high:
        return ""
    return (
        f"{key} is {given:g} N m/A, with which the {model} would take {stall / given:.3g} A at its stall torque of "
        f"{stall:g} N m, and such servos take {low:g} to {high:g} A: {_EFFECT}; divide the stall torque of the "
        "data sheet by the stall current"
    )


def check_current(key: str, constant: float, torque: float, own: float, where: str) -> None:
    """Raise DriverError if the torque limit `torque`, N m, needs a current that the drive's own limit contradicts.

    own: the drive's current limit, A. where: the register that holds it.
    """
    current = torque / constant
    if own / (100.0 * _BEYOND) <= current <= own * _BEYOND:
        return
    raise DriverError(
        f"with {key} = {constant:g} N m/A the torque limit of {torque:.3g} N m at the motor needs {current:.3g} A, and "
        f"the drive's own limit ({where}) is {own:.3g} A: correct {key}, or limits.torque"
    )
