"""Two files of one run as one table, such as the log of a drive and that of a load cell."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange.clocks import Shift, shift_of
from hil.exchange.columns import Table
from hil.exchange.expression import terms
from hil.uncertainty.criteria import TICK_SHARE

Array = NDArray[np.float64]
Part = tuple[Path, dict[str, Array]]
"""One of the files: its name, and each of its channels, in SI, in the order of time, (n,)."""

_GAP: Final = 3.5  # times between two readings, in which one or two may be missing
_EXPLAINED: Final = 0.3  # of the torque's power, which no deflection of another run explains


@dataclass(frozen=True, slots=True)
class Join:
    """A second file of a run. time: its column of the time, None: named as in the first file. shared: whether both
    files have one clock; otherwise their clocks differ by an unknown constant.
    """

    path: Path
    time: str | None = None
    shared: bool = False


def side(name: str, first: Table, second: Table) -> tuple[Table, str]:
    """Return the table that has a column, or every column of a sum, and its name in it; `FILE:NAME` says which.

    Raises WrongUse for a column that both have; one that none has is looked for in the first.
    """
    for table in (first, second):
        own = name.removeprefix(f"{table.source.name}:")
        if own != name:
            return table, own
    found = []
    for table in (first, second):
        with suppress(WrongUse):
            terms(name, table.place, table.has)
            found.append(table)
    if len(found) == 2:
        raise WrongUse(
            f"{first.source} and {second.source} both have {name!r}: write {second.source.name}:{name}, or "
            f"{first.source.name}:{name}"
        )
    return (found or [first])[0], name


def joined(one: Part, two: Part, *, shared: bool) -> tuple[dict[str, Array], str]:
    """Return the channels of both files, (n,) each, at times of the slower file, and what was done, in words.

    The readings of the faster file are interpolated, those of a command are held. Rows beside a gap of the faster file
    have no reading. Raises WrongUse if the files have no common time, or the clocks' difference cannot be found.
    """
    one, two = _rising(one), _rising(two)
    change, said = (0.0, "") if shared else _change(one, two)
    times = one[1]["time"], two[1]["time"] + change
    is_first_slow = np.median(np.diff(times[0])) >= np.median(np.diff(times[1]))
    (slow, fast), (own, other) = ((one, two), times) if is_first_slow else ((two, one), times[::-1])
    inside = (own >= other[0]) & (own <= other[-1])
    if not inside.any():
        spans = [f"from {time[0]:.9g} to {time[-1]:.9g} s" for time in times]
        raise WrongUse(
            f"{one[0]} is {spans[0]}, {two[0]} {spans[1]}, so they have no common time: name files of one run, or "
            "leave --shared-clock out if their clocks differ"
        )
    channels = {name: _at(own[inside], other, values, name) for name, values in fast[1].items()}
    channels |= {name: values[inside] for name, values in slow[1].items()}
    return channels | {"time": own[inside]}, said


def _rising(part: Part) -> Part:
    """Return the rows of a file whose time is later than that of the row before."""
    kept = np.append(True, np.diff(part[1]["time"]) > 0.0)
    if np.count_nonzero(kept) < 2:
        raise WrongUse(f"{part[0]} has fewer than two rows with a time: name the column of its time")
    return part[0], {name: values[kept] for name, values in part[1].items()}


def _change(one: Part, two: Part) -> tuple[float, str]:
    """Return what to add to the second file's times, s, and a sentence. Raises WrongUse if that cannot be found."""
    found = {name: (part, name) for part in (one, two) for name in part[1]}
    load, angle = found.get("torque"), found.get("dtheta") or found.get("motor_position")
    both = f"the clocks of {one[0]} and {two[0]}"
    how = "record both with one clock, and give --shared-clock"
    if "motor_torque" in found:
        raise WrongUse(f"{both} cannot be compared by the torque of a motor, whose inertia acts as a shift: {how}")
    if load is None or angle is None or load[0] is angle[0]:
        raise WrongUse(f"{both} can be compared only by the torque of one and the deflection of the other: {how}")
    shift = _shift(_good(*angle), _good(*load))
    if shift.explained < _EXPLAINED:
        raise WrongUse(
            f"{both} cannot be compared: at the best shift the deflection explains {100 * shift.explained:.0f} % of "
            "the torque's power, which is that of another run: name files of one run"
        )
    step = max(float(np.median(np.diff(part[1]["time"]))) for part in (one, two))
    if not shift.error < TICK_SHARE * step:
        raise WrongUse(
            f"{both} cannot be compared well enough: the shift has a standard error of {1e3 * shift.error:.2g} ms, "
            f"and Bc one of Kc times that: move at several speeds and longer, or {how}"
        )
    change = shift.seconds if load[0] is two else -shift.seconds
    return change, (
        f"the times of {two[0].name} are shifted by {change:.6f} s (within {2e3 * shift.error:.2g} ms) so "
        "that the torque fits the deflection"
    )


def _shift(angle: tuple[Array, Array], load: tuple[Array, Array]) -> Shift:
    try:
        return shift_of(*angle, *load)
    except (ValueError, IndexError, np.linalg.LinAlgError):  # too short, or without motion
        return Shift(0.0, np.inf, 0.0)


def _good(part: Part, name: str) -> tuple[Array, Array]:
    good = np.isfinite(part[1][name])
    return part[1]["time"][good], part[1][name][good]


def _at(wanted: Array, time: Array, values: Array, name: str) -> Array:
    """Return a channel (n,), read at times (n,), at other times (k,): NaN inside its gaps; of a command the last
    one.
    """
    from scipy.interpolate import CubicSpline

    good = np.isfinite(values)
    known, values = time[good], values[good]
    if len(known) < 2:
        return np.full(len(wanted), np.nan)
    after = np.clip(np.searchsorted(known, wanted), 1, len(known) - 1)
    found = values[after - (known[after] > wanted)] if name == "command" else CubicSpline(known, values)(wanted)
    gap = known[after] - known[after - 1] > _GAP * float(np.median(np.diff(time)))
    outside = (wanted < known[0]) | (wanted > known[-1])
    return np.where(gap | outside, np.nan, found)
