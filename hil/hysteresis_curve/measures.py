"""Measure the loops of torsion tests: stiffness, lost motion, hysteresis, play and loss, with their spread.

Harmonic Drive states K1, K2 and K3 over 0 to T1, T1 to T2 and above T2, and for planetary gears one stiffness above
15 % of the rated torque; its lost motion is at +-4 % of that torque (manuals 1018856, 08/2018, page 70, and 1019658,
11/2014, page 52). Nabtesco and Spinea take lost motion at +-3 %, on the centre line of the loop. Nabtesco calls the
width of the loop at zero torque hysteresis loss; other catalogues call it backlash. Play is defined in `Measures`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.errors import Untrustworthy
from hil.hysteresis_curve.branches import Branch, Torsion, branches_of, noise_of

Array = NDArray[np.float64]
Where = tuple[str, str, tuple[float, float]]
"""The branch, "loading" or "unloading"; the direction, "+", "-" or "both"; the part of the torque's range, N m."""

LINEAR: Final = 0.15
"""The share of the rated torque above which a gear is taken for linear (Harmonic Drive, planetary gears)."""
LOST_MOTION: Final = 0.03
"""The share of the rated torque at which lost motion is taken (Nabtesco, Spinea)."""
_REACHED: Final = 0.97
"""The rated torque, if it is not given, in parts of the torque reached: above it the torque reverses or rests."""
_FEWEST: Final = 3
"""The smallest number of points of a line."""

UNITS: Final = {"stiffness": "N*m/rad", "lost_motion": "rad", "hysteresis": "rad", "play": "rad", "loss": "J"}


@dataclass(frozen=True, slots=True)
class Spread:
    """A quantity over cycles and recordings: mean, smallest and largest, SI, and number of values.

    cycles, recordings: standard deviation of the cycles of one recording, and of the recordings' means; NaN for one.
    """

    mean: float
    low: float
    high: float
    count: int
    cycles: float
    recordings: float

    @classmethod
    def of(cls, values: Sequence[tuple[str, float]]) -> Spread:
        """Return the spread of values, each with the name of its recording."""
        every = np.array([value for _, value in values])
        names = dict.fromkeys(name for name, _ in values)
        groups = [every[[one == name for one, _ in values]] for name in names]
        means = np.array([group.mean() for group in groups])
        free = len(every) - len(groups)
        within = sum(float(((group - group.mean()) ** 2).sum()) for group in groups)
        return cls(
            mean=float(means.mean()),
            low=float(every.min()),
            high=float(every.max()),
            count=len(every),
            cycles=(within / free) ** 0.5 if free else float("nan"),
            recordings=float(means.std(ddof=1)) if len(means) > 1 else float("nan"),
        )


@dataclass(frozen=True, slots=True)
class Measures:
    """The measures of torsion tests.

    rated: the torque that stands for the rated torque, N m. parts: of the torque's range, N m. at: torque of the lost
    motion, N m. stiffness: by (branch, direction, part); direction is "+", "-" or "both", whose compliances are
    averaged. loops: lost_motion, the angle between +-`at` on the loop's centre line; hysteresis, the loop's width at
    zero torque; play, the angle between the loading lines of both directions, extended from above 15 % of `rated` to
    zero torque, which friction makes smaller; loss, the loop's area. by_recording: loading stiffness in the last part,
    both directions, of each recording, N m/rad.
    """

    rated: float
    parts: tuple[tuple[float, float], ...]
    at: float
    stiffness: Mapping[Where, Spread]
    loops: Mapping[str, Spread]
    by_recording: Mapping[str, float]
    tests: tuple[Torsion, ...]

    @property
    def loading(self) -> Spread:
        """Return the loading stiffness in the last part of the torque's range, both directions together, N m/rad."""
        return self.stiffness["loading", "both", self.parts[-1]]

    @property
    def noise(self) -> float:
        """Return the standard deviation of the torque's noise, N m, in the noisiest test."""
        return max(noise_of(one.torque) for one in self.tests)


def measure(
    tests: Sequence[Torsion],
    rated: float | None = None,
    parts: Sequence[tuple[float, float]] = (),
    at: float | None = None,
) -> Measures:
    """Return the measures of tests of one joint.

    rated: N m; None: the torque that every branch under load reaches. parts: N m; () for 0 to 15 % and 15 to 100 % of
    the rated torque. at: N m; None for 3 % of the rated torque. Raises Untrustworthy if a test is not slow, or no
    branch is long enough.
    """
    for test in tests:
        test.check_slow()
    cut = {test.name: branches_of(test) for test in tests}
    rated = _rated(cut) if rated is None else rated
    parts = tuple(parts) or ((0.0, LINEAR * rated), (LINEAR * rated, rated))
    at = LOST_MOTION * rated if at is None else at
    stiffness: dict[Where, list[tuple[str, float]]] = {}
    loops: dict[str, list[tuple[str, float]]] = {}
    for name, branches in cut.items():
        for where, values in _stiffness(branches, parts).items():
            stiffness.setdefault(where, []).extend((name, value) for value in values)
        for pair in _loops(branches):
            for quantity, value in _loop(*pair, at, rated).items():
                if np.isfinite(value):
                    loops.setdefault(quantity, []).append((name, value))
    if ("loading", "both", parts[-1]) not in stiffness:
        raise Untrustworthy(
            f"the stiffness from {parts[-1][0]:.3g} to {parts[-1][1]:.3g} N m is unknown: no branch of "
            f"{', '.join(cut)} loads the joint in this part, or the angle falls while the torque rises. Load the joint "
            "further, name other parts of the range with --part, or check the torque's sign"
        )
    return Measures(
        rated=rated,
        parts=parts,
        at=at,
        stiffness={key: Spread.of(values) for key, values in stiffness.items()},
        loops={key: Spread.of(values) for key, values in loops.items()},
        by_recording=dict(stiffness["loading", "both", parts[-1]]),
        tests=tuple(tests),
    )


def _stiffness(branches: Sequence[Branch], parts: Sequence[tuple[float, float]]) -> dict[Where, list[float]]:
    """Return the stiffness of each branch in each part, N m/rad, and of both directions together."""
    found: dict[Where, list[float]] = {}
    for part in parts:
        for kind in ("loading", "unloading"):
            lines = [(one, _line(one, part)) for one in branches if one.loading == (kind == "loading")]
            each = {sign: [line[0] for one, line in lines if line and one.direction == sign] for sign in "+-"}
            found |= {(kind, sign, part): [1.0 / slope for slope in each[sign]] for sign in "+-" if each[sign]}
            if means := [float(np.mean(slopes)) for slopes in each.values() if slopes]:
                found[kind, "both", part] = [1.0 / float(np.mean(means))]
    return found


def _rated(cut: Mapping[str, Sequence[Branch]]) -> float:
    """Return the torque, N m, that is taken as rated: the fraction `_REACHED` of the torque that every test reaches in
    both directions.

    0 if no branch is loading. cut: the branches of each test.
    """
    reached = []
    for branches in cut.values():
        for sign in (1, -1):
            largest = [one.largest for one in branches if one.sign == sign and one.loading]
            reached += [max(largest)] if largest else []
    found = max(reached, default=0.0)
    # a torque that only drifts about zero on one side is no direction of the test
    return _REACHED * min((one for one in reached if one > LINEAR * found), default=0.0)


def _line(branch: Branch, part: tuple[float, float]) -> tuple[float, float] | None:
    """Return slope, rad/(N m), and angle at zero torque, rad, of the line through a part of a branch; None if the
    branch covers less than half of the part, or the slope is not positive.
    """
    size = np.abs(branch.torque)
    inside = (size >= part[0]) & (size <= part[1])
    torque = branch.torque[inside]
    if len(torque) < _FEWEST or np.ptp(torque) < 0.5 * (part[1] - part[0]):
        return None
    slope, zero = np.polyfit(torque, branch.angle[inside], 1)
    return (float(slope), float(zero)) if slope > 0.0 else None


def _loops(branches: Sequence[Branch]) -> list[tuple[list[Branch], list[Branch]]]:
    """Return the strokes with rising torque, each with the stroke with falling torque that closes the loop.

    If a test begins and ends without torque, its last branch continues in its first branch.
    """
    strokes: dict[int, list[Branch]] = {}
    for one in branches:
        strokes.setdefault(one.stroke, []).append(one)
    found = list(strokes.values())
    if not found:
        return []
    first, last = found[0][0], found[-1][-1]
    if len(found) > 2 and first.loading and not last.loading and first.sign != last.sign:
        found = [[*found[-1], *found[0]], *found[1:-1]]
    rising = [one for one in found if (one[0].sign > 0) == one[0].loading]
    falling = [one for one in found if (one[0].sign > 0) != one[0].loading]
    return list(zip(rising, falling, strict=False))


def _loop(rising: Sequence[Branch], falling: Sequence[Branch], at: float, rated: float) -> dict[str, float]:
    """Return the measures of one loop; NaN for a measure that the loop does not show. rising, falling: branches of the
    two strokes. at, rated: torques, N m.
    """
    up, down = (_joined(stroke) for stroke in (rising, falling))
    middle = [0.5 * (_angle(up, torque) + _angle(down, torque)) for torque in (-at, at)]
    lines = [_line(one, (LINEAR * rated, rated)) for one in (*rising, *falling) if one.loading]
    zeros = [line[1] for line in lines if line is not None]
    torque, angle = np.concatenate([up[0], down[0]]), np.concatenate([up[1], down[1]])
    return {
        "lost_motion": middle[1] - middle[0],
        "hysteresis": _unloaded(falling) - _unloaded(rising),
        "play": zeros[0] - zeros[1] if len(zeros) == 2 else float("nan"),
        "loss": float(np.abs(0.5 * (torque * np.roll(angle, -1) - np.roll(torque, -1) * angle).sum())),
    }


def _joined(stroke: Sequence[Branch]) -> tuple[Array, Array]:
    return np.concatenate([one.torque for one in stroke]), np.concatenate([one.angle for one in stroke])


def _unloaded(stroke: Sequence[Branch]) -> float:
    """Return the angle of a stroke at zero torque, rad: at the end of unloading, or else at the start of loading."""
    nearest = slice(None, _FEWEST) if stroke[0].loading else slice(-_FEWEST, None)
    torque, angle = stroke[0].torque[nearest], stroke[0].angle[nearest]
    line = np.polynomial.Polynomial.fit(torque, angle, 1 if np.ptp(torque) > 0.0 else 0)
    return float(line(0.0))


def _angle(stroke: tuple[Array, Array], torque: float) -> float:
    """Return the angle at a torque of a stroke, rad; NaN beyond its ends.

    In a stroke the torque moves one way: the monotone torque nearest to the readings (isotonic regression) has their
    noise no more. Where it is level, as in a gap, the middle of the level counts.
    """
    from scipy.optimize import isotonic_regression

    rises = stroke[0][-1] > stroke[0][0]
    level, angle = isotonic_regression(stroke[0], increasing=rises).x, stroke[1]
    levels, count = np.unique(level, return_counts=True)
    middle = np.add.reduceat(angle[np.argsort(level, kind="stable")], np.cumsum(count) - count) / count
    return float(np.interp(torque, levels, middle, np.nan, np.nan))
