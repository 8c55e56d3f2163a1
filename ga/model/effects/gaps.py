"""The terms of a gap: backlash, a dead band, and a slack tendon. A gap subtracts a part of the deflection."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from ga.model.record import Mark, Term, searched

if TYPE_CHECKING:
    from ga.arrays import Array
    from ga.model.trajectory import Motion

WIDEST_GAP: Final = 0.95
"""The largest fraction of the whole deflection that a gap or slack may take."""

GAPS: Final = ("backlash", "deadband", "slack")
"""The terms of a gap; a model has at most one of them."""


def _others(name: str) -> tuple[str, ...]:
    return tuple(other for other in GAPS if other != name)


_ONE_GAP: Final = (
    "backlash, deadband and slack are three kinds of one gap, and a single tendon (slack) has no second flank"
)


def _beyond_gap(angle: Array, values: Array) -> Array:
    import numpy as np

    gap, centre = values
    from_centre = angle - centre
    return np.asarray(np.sign(from_centre) * np.maximum(np.abs(from_centre) - 0.5 * gap, 0.0))


def _gap_shifts(angle: Array) -> tuple[Array, ...]:
    import numpy as np

    return 0.5 * np.sign(angle), np.sign(angle) ** 2


def _open(values: Array) -> tuple[float, float]:
    gap, centre = values.tolist()
    return centre - 0.5 * gap, centre + 0.5 * gap


def _beyond_slack(angle: Array, values: Array) -> Array:
    import numpy as np

    return np.asarray(np.maximum(angle - values[0], 0.0))


def _slack_shifts(angle: Array) -> tuple[Array, ...]:
    import numpy as np

    return (np.sign(angle),)


def _pushing_only(angle: Array, motion: Motion, lag: float) -> Array:
    import numpy as np

    return np.asarray((angle * (angle + lag * motion.dtheta_dot) > 0.0).astype(np.float64))


def _gap_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    least, span = extent(motion)
    return (0.0, WIDEST_GAP * span), (least, least + span)


def _slack_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    least, span = extent(motion)
    return ((least, least + WIDEST_GAP * span),)


def extent(motion: Motion) -> tuple[float, float]:
    """Return the smallest deflection of a motion, rad, and the range of its deflection, rad."""
    least = float(motion.dtheta.min())
    return least, float(motion.dtheta.max() - motion.dtheta.min())


_GAP: Final = searched(
    "gap",
    "rad",
    "play of the coupling, its whole width",
    "gap width",
    presence=True,
    positive=True,
    starts=(0.0, 0.03, 0.1, 0.25, 0.5),
    kinked=True,
    refined=True,
    about="centre",
)
_CENTRE: Final = searched(
    "centre",
    "rad",
    "deflection in the middle of the play",
    "gap middle",
    absent=None,
    starts=(0.3, 0.5, 0.7),
    kinked=True,
    refined=True,
)

BACKLASH: Final = Term(
    "backlash",
    "a gap with a flank on both sides",
    (_GAP, _CENTRE),
    bounds=_gap_bounds,
    remaining=_beyond_gap,
    shifts=_gap_shifts,
    contact=_pushing_only,
    selection="considered",
    role="play",
    open=_open,
    mark=Mark(
        "backlash", "a gap or dead band", "try --model {backlash}, or {deadband} where the damper acts in the gap too"
    ),
    needs="offset",
    excludes=_others("backlash"),
    reason=_ONE_GAP,
    breaks=True,
    example="gap 1, 4, 20 % of stroke; centre 0",
    equation="x counts from the flank that touches, at centre + gap/2 or centre - gap/2; between them tau is 0",
)

DEADBAND: Final = replace(
    BACKLASH,
    name="deadband",
    meaning="a gap of the spring only, in which the damper still acts",
    contact=None,
    mark=None,
    excludes=_others("deadband"),
    equation="x counts from the flank that touches, at centre + gap/2 or centre - gap/2; between them x is 0",
)

SLACK: Final = Term(
    "slack",
    "a tendon that only pulls",
    (
        searched(
            "slack",
            "rad",
            "deflection before the tendon pulls",
            "slack end",
            absent=None,
            starts=(0.05, 0.2, 0.4, 0.6, 0.8),
            kinked=True,
            refined=True,
        ),
    ),
    bounds=_slack_bounds,
    remaining=_beyond_slack,
    shifts=_slack_shifts,
    contact=_pushing_only,
    selection="considered",
    role="play",
    open=lambda values: (float("-inf"), values.item()),
    needs="offset",
    excludes=_others("slack"),
    reason=_ONE_GAP,
    breaks=True,
    example="slack -45, -25, 0 % of stroke",
    equation="x counts from slack; below it tau is 0",
)
