"""Check whether torque and deflection can be those of a joint: a wrong unit shows in their size, a wrong sign in Kc."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple, Self

import numpy as np

from ga.arrays import Array
from ga.model.trajectory import Motion
from hil import units
from hil.diagnostics import Diagnostic
from hil.signals.constants import ENOUGH, MAJORITY, OVER_LIMIT, PREFIX, SIGN_SURE, TURN
from hil.stand.file import LimitsTable

_MISTAKEN: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "torque": ("mN*m", "N*m", "N*cm", "kgf*cm", "ozf*in", "uN*m", "gf*cm", "lbf*in"),
        "angle": ("deg", "rad", "mrad", "arcmin"),
    }
)
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "u"))


class Swing(NamedTuple):
    """The smallest and the largest reading of a channel, SI. factor: the factor from the unit in which it was read to
    SI.
    """

    least: float
    largest: float
    factor: float = 1.0

    @property
    def half(self) -> float:
        """Half the range, in which an offset of the sensor cancels."""
        return (self.largest - self.least) / 2.0

    @classmethod
    def of(cls, values: Array, factor: float = 1.0) -> Self:
        """Return the smallest and the largest of those values (n,) that are numbers; 0 and 0 if there are none."""
        good = values[np.isfinite(values)]
        return cls(float(good.min()), float(good.max()), factor) if good.size else cls(0.0, 0.0, factor)


def in_words(torque: Swing, deflection: Swing) -> str:
    """Return the ranges of torque and deflection as text: "torque -12 to 12 N m; deflection -3 to 4 rad, a span of 1.11
    turns".
    """
    span = 2.0 * deflection.half
    turned = f"{span / TURN:.3g} turns" if _is_over_a_turn(deflection) else f"{math.degrees(span):.3g} deg"
    return f"torque {_range(torque, 'N m')}; deflection {_range(deflection, 'rad')}, a span of {turned}"


def _range(swing: Swing, unit: str) -> str:
    size = max(abs(swing.least), abs(swing.largest))
    scale, prefix = next(
        (pair for pair in _PREFIXES if float(f"{size:.3g}") >= pair[0]), _PREFIXES[-1] if size else _PREFIXES[0]
    )
    return f"{swing.least / scale + 0.0:.3g} to {swing.largest / scale + 0.0:.3g} {prefix}{unit}"


def unit_diagnostics(torque: Swing, deflection: Swing, limits: LimitsTable | None) -> list[Diagnostic]:
    """Return a warning for each channel that is too large for the stand, with the unit that would explain it.

    A deflection of more than a turn is an error, unless the stand's limits allow it.
    """
    if limits is None:
        return _many_turns(deflection)
    diagnostics = _over_limit("torque", "torque", torque, limits.torque, "N m")
    diagnostics += [
        replace(diagnostic, is_error=_is_over_a_turn(deflection))
        for diagnostic in _over_limit("deflection", "angle", deflection, limits.deflection, "rad")
    ]
    return diagnostics or _odd_stiffness(torque, deflection, limits)


def excess(torque: Swing, deflection: Swing, limits: LimitsTable) -> float:
    """Return the ratio of the torque or of the deflection to its limit, the larger of the two ratios."""
    return max(torque.half / limits.torque, deflection.half / limits.deflection)


def negative_stiffness(motion: Motion, torque: Array) -> float | None:
    """Return the stiffness, N m/rad, if stiffness and damping are both negative and explain most of the torque (n,), N
    m; else None.

    Both are fitted by least squares, with an inertia and an offset. If None is returned, no sign is wrong. At one
    frequency an inertia equals a negative stiffness, but not a negative damping, so the damping must be equally
    certain.
    """
    one_frequency = motion.has_one_frequency
    rows = slice(None, None, max(1, len(motion) // ENOUGH))
    inertia = () if one_frequency else (motion.dtheta_ddot,)
    columns = np.stack([motion.dtheta, motion.dtheta_dot, *inertia], axis=1)[rows]
    columns = columns - columns.mean(axis=0)
    sizes = np.linalg.norm(columns, axis=0)
    rest = (torque - motion.known)[rows]
    rest = rest - rest.mean()
    if not (sizes > 0.0).all():
        return None
    columns = columns / sizes
    values, _, rank, _ = np.linalg.lstsq(columns, rest, rcond=None)
    left = float(np.var(rest - columns @ values))
    if rank < columns.shape[1] or left > MAJORITY * float(np.var(rest)):
        return None
    errors = np.sqrt(left * np.diag(np.linalg.inv(columns.T @ columns)))
    negative = values[0] < -SIGN_SURE * errors[0] and values[1] < (-SIGN_SURE if one_frequency else 1.0) * errors[1]
    return float(values[0] / sizes[0]) if negative else None


def wrong_sign(stiffness: float, *, imported: bool) -> Diagnostic:
    """Return the error for a recording with a negative stiffness, N m/rad. imported: whether the recording is an
    imported table.
    """
    remedy = "Import the table again with --torque-scale -1, or with --dtheta-scale -1 if the angle is wrong"
    if not imported:
        remedy = "Correct the sign in the stand file (hil doctor --move finds it), and record again"
    return Diagnostic(
        "implausible",
        f"Kc would be {stiffness:.3g} N m/rad, but it cannot be negative. A sign is wrong, so neither Kc nor Bc can be "
        f"identified: a positive torque must make a positive deflection. {remedy}",
        is_error=True,
    )


def _over_limit(name: str, dimension: str, swing: Swing, limit: float, unit: str) -> list[Diagnostic]:
    if not swing.half > OVER_LIMIT * limit:
        return []
    size, times = f"{swing.half:.3g} {unit}", swing.half / limit
    message = f"the {name} swings by +/- {size}, {times:.3g} times the stand's limit of {limit:.3g} {unit}"
    meaning = "If its unit is wrong, Kc and Bc are wrong by the same factor"
    return [Diagnostic("wrong-unit", f"{message}. {meaning}. {_likely(dimension, swing, limit)}")]


def _likely(dimension: str, swing: Swing, limit: float) -> str:
    option = "torque" if dimension == "torque" else "dtheta"
    for unit in _MISTAKEN[dimension]:
        if limit / PREFIX <= swing.half / swing.factor * units.factor(dimension, unit) <= OVER_LIMIT * limit:
            return (
                f"The readings are likely in {unit}: import them with --{option}-unit {unit}, or correct [limits] of "
                "the stand file"
            )
    return f"Check --{option}-unit and the sensor's scale, or correct [limits] of the stand file"


def _is_over_a_turn(deflection: Swing) -> bool:
    """Return whether the deflection spans more than a turn. No coupling deflects as far, unless the limits of its stand
    allow it.
    """
    return 2.0 * deflection.half > TURN


def _many_turns(deflection: Swing) -> list[Diagnostic]:
    if not _is_over_a_turn(deflection):
        return []
    message = (
        f"the deflection spans {2.0 * deflection.half / TURN:.3g} turns, which no coupling does. If the column is "
        "in degrees, Kc and Bc are 57 times too low. Import it with --dtheta-unit deg, or check the gear ratio. Where "
        "the joint does turn so far, import it with --stand FILE, whose limits.deflection allows it"
    )
    return [Diagnostic("wrong-unit", message, is_error=True)]


def _odd_stiffness(torque: Swing, deflection: Swing, limits: LimitsTable) -> list[Diagnostic]:
    expected = limits.torque / limits.deflection
    if not (torque.half > 0.0 and deflection.half > 0.0):
        return []
    ratio = torque.half / deflection.half / expected
    if 1.0 / PREFIX < ratio < PREFIX:
        return []
    message = (
        f"torque over deflection is {ratio * expected:.3g} N m/rad, {ratio:.3g} times the ratio of the stand's limits: "
        "if a unit is wrong, Kc is wrong by that factor. Check the units of torque and deflection, or correct [limits]"
    )
    return [Diagnostic("wrong-unit", message, "Kc")]
