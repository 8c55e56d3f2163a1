"""SimpleFOC's Commander as text: how a command is written and what a reply says. No I/O.

Source: Arduino-FOC, src/communication/Commander.cpp and commands.h, library 2.2 to 2.4, verbose mode 3, machine
readable: a reply begins with its command's letters and holds nothing but the value.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

DECIMALS = 5
"""Digits behind the point that the board is told to print."""
_STEP = 10.0**-DECIMALS  # A
_FRESH = 10  # the last digit of a target only tells one request from another
RESOLUTION = _STEP * _FRESH
"""A of a target that means something."""
_NUMBER = rf"-?\d+\.\d{{{DECIMALS}}}"
_STATE = re.compile(";".join([f"({_NUMBER})"] * 7))


class State(NamedTuple):
    """What `MG7` tells. target: of the board, A. current: Iq, A. velocity rad/s, angle rad."""

    target: float
    current: float
    velocity: float
    angle: float


def state(text: str) -> State | None:
    """The seven numbers target;Vq;Vd;Iq;Id;velocity;angle; None where they are not these, each with its digits."""
    found = _STATE.fullmatch(text)
    if found is None:
        return None
    numbers = [float(number) for number in found.groups()]
    return State(numbers[0], numbers[3], numbers[5], numbers[6])


def number(text: str) -> float | None:
    """A number as the board prints it; None for anything else."""
    return float(text) if re.fullmatch(_NUMBER, text) else None


def target(current: float, count: int) -> str:
    """A target of `current` A, as near to zero as `RESOLUTION` allows, with `count` in its last digit.

    Commander has no sequence numbers and no checksum. The reply repeats the target, so that a digit that means nothing
    to the motor proves which request it answers.
    """
    steps = math.floor(abs(current) / RESOLUTION + 1e-9) * _FRESH + count % _FRESH
    return f"{'-' if current < 0.0 else ''}{steps // 10**DECIMALS}.{steps % 10**DECIMALS:0{DECIMALS}}"


def same(sent: str, told: float) -> bool:
    """Whether the board's target is the one that was sent; it keeps 24 bits of it."""
    return abs(float(sent) - told) < 0.6 * _STEP
