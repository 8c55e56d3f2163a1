"""Two files of one run as one table, such as the log of a drive and that of a load cell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange.columns import Table
from hil.exchange.wanted.clocks import Shift, shift_of
from hil.exchange.wanted.expression import terms
from hil.uncertainty.criteria import TICK_SHARE

Array = NDArray[np.float64]

_GAP: Final = 3.5  # times between two readings, in which one or two may be missing
_EXPLAINED: Final = 0.3  # of the torque's power, which no deflection of another run explains
_SURE: Final = 4.0  # standard errors

_TORQUES, _ANGLES = ("torque", "motor_torque"), ("dtheta", "motor_position")


@dataclass(frozen=True, slots=True)
class Join:
    """A second file of a run. time: its column of the time, None: named as in the first file. shared: whether both
    files have one clock; otherwise their clocks differ by an unknown constant.
    """

    path: Path
    time: str | None = None
    shared: bool = False


class Part(NamedTuple):
    """One of the files: each of its channels, in SI, and their times, in order, (n,)."""

    source: Path
    channels: dict[str, Array]

    @property
    def time(self) -> Array:
        """Return the times (n,), s."""
        return self.channels["time"]


def side(name: str, first: Table, second: Table) -> tuple[Table, str]:
    """Return the table that has a column, or every column of a sum, and its name in it; `FILE:NAME` says which.

    Raises WrongUse for a column that both have; one that none has is looked for in the first.
    """
    for table in (first, second):
        own = name.removeprefix(f"{table.source.name}:")
        if own != name:
            return table, own
    found = [table for table in (first, second) if _has(table, name)]
    if len(found) == 2:
        raise WrongUse(
            f"{first.source} and {second.source} both have {name!r}: write {second.source.name}:{name}, or "
            f"{first.source.name}:{name}"
        )
    return (found or [first])[0], name


def _has(table: Table, name: str) -> bool:
    try:
        return bool(terms(name, table.place, table.has))
    except WrongUse:
        return False


def joined(one: Part, two: Part, *, shared: bool) -> tuple[dict[str, Array], str]:
    """Return the channels of both files, (n,) each, at times of the slower file, and what was done, in words.

    The readings of the faster file are interpolated, those of a command are held. Rows beside a gap of the faster file
    have no reading. Raises WrongUse if the files have no common time, or the clocks' difference cannot be found.
    """
    one, two = _rising(one), _rising(two)
    said = ""
    if not shared:
        change, said = _change(one, two)
        two = Part(two.source, two.channels | {"time": two.time + change})
    slow, fast = (one, two) if np.median(np.diff(one.time)) >= np.median(np.diff(two.time)) else (two, one)
    inside = (slow.time >= fast.time[0]) & (slow.time <= fast.time[-1])
    if not inside.any():
        raise WrongUse(
            f"{one.source} is from {one.time[0]:.9g} to {one.time[-1]:.9g} s, {two.source} from {two.time[0]:.9g} to "
            f"{two.time[-1]:.9g} s, so they have no common time: name files of one run, or leave --shared-clock out if "
            "their clocks differ"
        )
    channels = {name: _at(slow.time[inside], fast, name) for name in fast.channels}
    return channels | {name: values[inside] for name, values in slow.channels.items()}, said


def _rising(part: Part) -> Part:
    """Return the rows of a file whose time is later than that of the row before."""
    kept = np.append(True, np.diff(part.time) > 0.0)
    if np.count_nonzero(kept) < 2:
        raise WrongUse(f"{part.source} has fewer than two rows with a time: name the column of its time")
    return Part(part.source, {name: values[kept] for name, values in part.channels.items()})


def _change(one: Part, two: Part) -> tuple[float, str]:
    """Return what to add to the second file's times, s, and a sentence. Raises WrongUse if that cannot be found."""
    angles, loads, sign = (one, two, 1.0) if {*_ANGLES} & {*one.channels} else (two, one, -1.0)
    torque = next((name for name in _TORQUES if name in loads.channels), None)
    angle = next((name for name in _ANGLES if name in angles.channels), None)
    both = f"the clocks of {one.source} and {two.source}"
    how = "record both with one clock, and give --shared-clock"
    if torque is None or angle is None:
        raise WrongUse(f"{both} can be compared only by the torque of one and the deflection of the other: {how}")
    if torque == "motor_torque":
        raise WrongUse(f"{both} cannot be compared by the torque of a motor, whose inertia acts as a shift: {how}")
    shift = _shift(_good(angles, angle), _good(loads, torque))
    step = max(float(np.median(np.diff(one.time))), float(np.median(np.diff(two.time))))
    if shift.explained < _EXPLAINED:
        raise WrongUse(
            f"{both} cannot be compared: at the best shift the deflection explains {100 * shift.explained:.0f} % of "
            "the torque's power, which is that of another run: name files of one run"
        )
    span = float(one.time[-1] - one.time[0])
    if not shift.error < TICK_SHARE * step:
        raise WrongUse(
            f"{both} cannot be compared well enough: the shift has a standard error of {1e3 * shift.error:.2g} ms, "
            f"and Bc one of Kc times that: move at several speeds and longer, or {how}"
        )
    if abs(shift.drift) > _SURE * shift.drift_error and abs(shift.drift) * span > step:
        raise WrongUse(f"{both} run apart by {1e3 * abs(shift.drift):.2g} ms in each second, so no shift fits: {how}")
    change = sign * shift.seconds
    return change, (
        f"the times of {two.source.name} are shifted by {change:.6f} s (within {2e3 * shift.error:.2g} ms) so "
        "that the torque fits the deflection"
    )


def _shift(angle: tuple[Array, Array], load: tuple[Array, Array]) -> Shift:
    try:
        return shift_of(*angle, *load)
    except (ValueError, IndexError, np.linalg.LinAlgError):  # too short, or without motion
        return Shift(0.0, np.inf, 0.0, np.inf, 0.0)


def _good(part: Part, name: str) -> tuple[Array, Array]:
    good = np.isfinite(part.channels[name])
    return part.time[good], part.channels[name][good]


def _at(time: Array, part: Part, name: str) -> Array:
    """Return a channel of the faster file at other times (k,), NaN inside its gaps; of a command the last one."""
    from scipy.interpolate import CubicSpline

    known, values = _good(part, name)
    if len(known) < 2:
        return np.full(len(time), np.nan)
    after = np.clip(np.searchsorted(known, time), 1, len(known) - 1)
    found = values[after - (known[after] > time)] if name == "command" else CubicSpline(known, values)(time)
    gap = known[after] - known[after - 1] > _GAP * float(np.median(np.diff(part.time)))
    outside = (time < known[0]) | (time > known[-1])
    return np.where(gap | outside, np.nan, found)
