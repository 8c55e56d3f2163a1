"""Numbers that were logged without their sign, in two's complement or with a sign bit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.recording.channels import LARGEST

Array = NDArray[np.float64]

_LEAST = 128.0  # counts, below which the largest number has no sign bit
_SMOOTHER = 0.9  # of the sum of all steps, that a decoded column has at most
_EXPLAINED = 0.25  # of the torque that the deflection does not explain, that is left once both are decoded
_ON_GRID = 0.05  # of a count, within which a number is a whole number of them
_ROWS = 20_000  # that are looked at


def decoded(values: Array, code: str) -> Array:
    """Return the numbers (n,) with their sign.

    code: "wrap=65536" for two's complement of 16 bits, or an encoder that begins anew at 65536; "sign=1024" for a sign
    bit of value 1024 above the magnitude; "none" for numbers with a sign. Raises WrongUse for any other code.
    """
    if code == "none":
        return values
    match = re.fullmatch(r"(wrap|sign)=(\d+\.?\d*(?:e[-+]\d+)?)", code)
    if match is None or not (size := float(match[2])) > 0.0:
        raise WrongUse(
            f"{code!r} is no code of numbers: write wrap=65536 for 16 bits in two's complement, sign=1024 for a sign "
            "bit above 10 bits, or none"
        )
    if match[1] == "sign":
        return np.where(values >= size, size - values, values)
    return (values + 0.5 * size) % size - 0.5 * size


def size_of(code: str) -> float:
    """Return the number in a code, in the units of its column."""
    return float(code.partition("=")[2])


def recognised(torque: Array, dtheta: Array) -> tuple[str, str]:
    """Return the codes of torque and deflection (n,), in the units of their columns; "none" for a column with its sign.

    A code is recognised if the column has no negative number and is smoother when decoded, and if deflection and rate
    then explain most of the torque that they do not explain without decoding.
    """
    good = (np.abs(torque) < LARGEST) & (np.abs(dtheta) < LARGEST)
    pairs = list(product(["none", *_possible(torque[good])], ["none", *_possible(dtheta[good])]))
    if len(pairs) == 1:
        return pairs[0]
    left = [_unexplained(decoded(torque[good], one), decoded(dtheta[good], other)) for one, other in pairs]
    best = int(np.argmin(left))
    return pairs[best] if left[best] < _EXPLAINED * left[0] else pairs[0]


def _possible(values: Array) -> Iterator[str]:
    """Yield the codes that make a column (n,), which has no negative number, smoother."""
    if len(values) < 3 or np.ptp(values) == 0.0 or values.min() < 0.0 or not (count := _count(values)):
        return
    top = float(values.max()) / count
    if top < _LEAST:
        return
    bits = np.floor(np.log2(top))
    for kind, size in (("wrap", 2.0 ** (bits + 1.0)), ("sign", 2.0**bits)):
        code = f"{kind}={size * count:.10g}"
        if _roughness(decoded(values, code)) < _SMOOTHER * _roughness(values):
            yield code


def _count(values: Array) -> float:
    """Return the step of which all values (n,) are multiples; 0 if there is none."""
    if not (values % 1.0).any():
        return 1.0
    levels = np.unique(values)
    step = float(np.diff(levels).min())
    for value in levels[levels > 0.0].tolist():
        step = value / max(round(value / step), 1)
    return step if np.abs(values / step - np.round(values / step)).max() < _ON_GRID else 0.0


def _roughness(values: Array) -> float:
    return float(np.abs(np.diff(values)).sum())


def _unexplained(torque: Array, dtheta: Array) -> float:
    """Return the fraction of the torque's variance that deflection and rate do not explain."""
    torque, dtheta = torque[:_ROWS], dtheta[:_ROWS]
    if np.ptp(torque) == 0.0:
        return 1.0
    columns = np.column_stack([np.ones_like(dtheta), dtheta, np.gradient(dtheta)])
    rest = torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
    return float(np.var(rest) / np.var(torque))
