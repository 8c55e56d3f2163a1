"""Encode commands and decode replies of SimpleFOC's Commander. Text only, no I/O.

Source: Arduino-FOC, src/communication/Commander.cpp and commands.h, library 2.2 to 2.4, in verbose mode 3 (machine
readable). A reply is the letters of its command followed by the value.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

DECIMALS = 5
"""Number of decimals that the board is set to print."""
_STEP = 10.0**-DECIMALS  # A
_FRESH = 10  # the last digit of a target only distinguishes requests
RESOLUTION = _STEP * _FRESH
"""A: one step of a target current."""
_NUMBER = rf"-?\d+\.\d{{{DECIMALS}}}"
_STATE = re.compile(";".join([f"({_NUMBER})"] * 7))


class CommanderState(NamedTuple):
    """The reply to `MG7`. target: the target current that the board repeats, A. current: Iq, A. velocity: rad/s. angle:
    rad.
    """

    target: float
    current: float
    velocity: float
    angle: float


def state(text: str) -> CommanderState | None:
    """Decode the line target;Vq;Vd;Iq;Id;velocity;angle. Return None if `text` is not seven numbers with all their
    digits.
    """
    match = _STATE.fullmatch(text)
    if match is None:
        return None
    numbers = [float(number) for number in match.groups()]
    return CommanderState(numbers[0], numbers[3], numbers[5], numbers[6])


def number(text: str) -> float | None:
    """Return the number that the board printed; None if `text` is no number."""
    return float(text) if re.fullmatch(_NUMBER, text) else None


def target(current: float, count: int) -> str:
    """Return the text of a target of `current`, A, rounded towards zero to `RESOLUTION`. The last digit holds `count`.

    Commander has no sequence numbers and no checksum. A reply repeats the target, so a digit below the motor's
    resolution identifies the request.
    """
    steps = math.floor(abs(current) / RESOLUTION + 1e-9) * _FRESH + count % _FRESH
    return f"{'-' if current < 0.0 else ''}{steps // 10**DECIMALS}.{steps % 10**DECIMALS:0{DECIMALS}}"


def same(sent: str, reported: float) -> bool:
    """Return whether the target `reported` by the board equals the target `sent`. The board stores targets as 32 bit
    floats, with 24 bits of precision.
    """
    return abs(float(sent) - reported) < 0.6 * _STEP
