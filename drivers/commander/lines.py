"""SimpleFOC's Commander as text: encoding of commands and decoding of replies, without I/O.

Source: Arduino-FOC, src/communication/Commander.cpp and commands.h, library 2.2 to 2.4, verbose mode 3, machine
readable: a reply is the letters of its command followed by the value.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

DECIMALS = 5
"""Decimals that the board is set to print."""
_STEP = 10.0**-DECIMALS  # A
_FRESH = 10  # the last digit of a target only distinguishes requests
RESOLUTION = _STEP * _FRESH
"""A: the resolution of a target."""
_NUMBER = rf"-?\d+\.\d{{{DECIMALS}}}"
_STATE = re.compile(";".join([f"({_NUMBER})"] * 7))


class CommanderState(NamedTuple):
    """The reply to `MG7`. target: of the board, A. current: Iq, A. velocity rad/s, angle rad."""

    target: float
    current: float
    velocity: float
    angle: float


def state(text: str) -> CommanderState | None:
    """Decode target;Vq;Vd;Iq;Id;velocity;angle; None where `text` is not seven numbers with all their digits."""
    match = _STATE.fullmatch(text)
    if match is None:
        return None
    numbers = [float(number) for number in match.groups()]
    return CommanderState(numbers[0], numbers[3], numbers[5], numbers[6])


def number(text: str) -> float | None:
    """Return a number that the board printed; None for any other text."""
    return float(text) if re.fullmatch(_NUMBER, text) else None


def target(current: float, count: int) -> str:
    """Return a target of `current` A, rounded towards zero to `RESOLUTION`, with `count` in its last digit.

    Commander has no sequence numbers and no checksum. The reply repeats the target, so a digit below the motor's
    resolution identifies the request.
    """
    steps = math.floor(abs(current) / RESOLUTION + 1e-9) * _FRESH + count % _FRESH
    return f"{'-' if current < 0.0 else ''}{steps // 10**DECIMALS}.{steps % 10**DECIMALS:0{DECIMALS}}"


def same(sent: str, reported: float) -> bool:
    """Return whether the board's target is the one that was sent; it keeps 24 bits of it."""
    return abs(float(sent) - reported) < 0.6 * _STEP
