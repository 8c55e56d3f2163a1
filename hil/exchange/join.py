"""Two files of one run as one table, such as the log of a drive and that of a load cell."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange.columns import Table
from hil.signals import constants as c

Array = NDArray[np.float64]
Part = tuple[Path, dict[str, Array]]
"""One of the files: its name, and each of its channels, in SI, in the order of time, (n,)."""

_GAP: Final = 3.5  # times between two readings, in which one or two may be missing
_DRIFTS: Final = 6.0  # standard errors, from which a drift of the clocks is one
_FASTEST: Final = 2e-3  # s/s, largest drift of two clocks
_EXPLAINED: Final = 0.3  # of the torque's power, which no deflection of another run explains
_PIECES: Final = 8  # of the common time: the scatter of their own shifts gives the error
_COMMON: Final = 0.5  # of the shorter file, which lies in both
_EXCITED: Final = 0.995  # of the power that rate and torque have in common, up to the upper end of the band
_ABOVE: Final = 1.5  # times that end, up to which both are compared
_AROUND: Final = 1.0  # periods of that frequency, around the first estimate, in which the shift is searched


@dataclass(frozen=True, slots=True)
class Join:
    """A second file of a run. time: its time column; None: the name of the first file's time column. shared: whether
    both files have one clock; otherwise their clocks differ by an unknown constant.
    """

    path: Path
    time: str | None = None
    shared: bool = False


def side(name: str, first: Table, second: Table) -> tuple[Table, str]:
    """Return the table that has the column `name`, or all columns of that sum, and the name without `FILE:`.

    `FILE:NAME` chooses a table. If neither table has the column, return the first. Raises WrongUse if both have it.
    """
    for table in (first, second):
        own = name.removeprefix(f"{table.source.name}:")
        if own != name:
            return table, own
    found = []
    for table in (first, second):
        with suppress(WrongUse):
            table.terms(name)
            found.append(table)
    if len(found) == 2:
        raise WrongUse(
            f"{first.source} and {second.source} both have {name!r}: write {second.source.name}:{name}, or "
            f"{first.source.name}:{name}"
        )
    return (found or [first])[0], name


def joined(one: Part, two: Part, *, shared: bool) -> tuple[dict[str, Array], str]:
    """Return the channels of both files, (n,) each, at times of the slower file, and what was done, in words.

    The readings of the faster file are interpolated; a command keeps its last value. Rows beside a gap of the faster
    file have no reading. Raises WrongUse if the files have no common time, or the clocks' difference cannot be found.
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
    """Return the shift to add to the second file's times, s, and a sentence about it. Raises WrongUse without a clear
    shift.
    """
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
    if shift.drift:
        faster = shift.drift if load[0] is two else -shift.drift
        raise WrongUse(
            f"{both} drift apart by {1e6 * faster:.0f} ppm, so no constant shift fits and Bc would be wrong: scale the "
            f"times of {two[0].name}, --join-time '{1.0 + faster:.6f}*NAME', with the name of its time"
        )
    if not shift.error < c.TICK_SHARE * step:
        raise WrongUse(
            f"{both} cannot be compared well enough: the shift has a standard error of {1e3 * shift.error:.2g} ms, "
            f"and Bc an error of Kc times that: move at several speeds and longer, or {how}"
        )
    change = shift.seconds if load[0] is two else -shift.seconds
    return change, (
        f"the times of {two[0].name} are shifted by {change:.6f} s (within {2e3 * shift.error:.2g} ms) so "
        "that the torque fits the deflection"
    )


def _shift(angle: tuple[Array, Array], load: tuple[Array, Array]) -> _Shift:
    try:
        return _shift_of(*angle, *load)
    except (ValueError, IndexError, np.linalg.LinAlgError):  # too short, or without motion
        return _Shift(0.0, np.inf, 0.0)


def _good(part: Part, name: str) -> tuple[Array, Array]:
    good = np.isfinite(part[1][name])
    return part[1]["time"][good], part[1][name][good]


def _at(wanted: Array, time: Array, values: Array, name: str) -> Array:
    """Return a channel at the times `wanted` (k,), s, from `values` (n,) at `time` (n,), s. Inside gaps it is NaN; a
    command keeps its last value.
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


@dataclass(frozen=True, slots=True)
class _Shift:
    """The shift to add to the torque's clock, s, and its standard error, s, which is also large if the clocks drift
    apart. explained: the fraction of the torque's power that deflection and rate explain after the shift. drift:
    how fast the shift grows, s/s, if it changes by more than an age that Bc tolerates; else 0.
    """

    seconds: float
    error: float
    explained: float
    drift: float = 0.0


def _shift_of(time: Array, dtheta: Array, other: Array, torque: Array) -> _Shift:
    """Return the shift with which `torque` (m,) at times `other` (m,), s, fits `dtheta` (n,) at times `time` (n,), s.

    The torque is fitted as that of a spring that may harden, damping, friction, an offset and a drift. Stiffness and
    damping have one sign: a shift of 2 Bc/Kc with a negative damping would fit nearly as well. A motion with a single
    frequency does not determine the shift, so its error is large then.
    """
    step = max(float(np.median(np.diff(time))), float(np.median(np.diff(other))))
    coarse, explained = _coarse(step, time, dtheta, other, torque)
    grid, load, angle, highest = _filtered(step, time, dtheta, other + coarse, torque)

    def misfits(shift: float | Array) -> Array:
        """Return the sum of the squared residuals in each piece; inf if the damping is negative."""
        near, rate = angle(grid + shift), angle(grid + shift, 1)
        friction = np.tanh(10.0 * rate / rate.std())
        columns = np.column_stack([near, rate, near**3, friction, np.ones_like(grid), grid - grid.mean()])
        scale = np.abs(columns).max(axis=0)
        found = np.linalg.lstsq(columns / scale, load, rcond=None)[0] / scale
        left = (load - columns @ found) ** 2
        sums = np.array([piece.sum() for piece in np.array_split(left, _PIECES)])
        return np.where(found[0] * found[1] < 0.0, np.inf, sums)

    tried = np.arange(-_AROUND / highest, _AROUND / highest, step)
    best = float(tried[np.argmin([misfits(one).sum() for one in tried])])
    own, best = _refined(misfits, best, step)
    apart = grid - grid.mean()
    drift = _drift(lambda drift: float(misfits(best + drift * apart).sum()), 2.0 * highest * float(np.ptp(grid)))
    matters = abs(drift) * float(apart.max()) > c.TICK_SHARE * step
    return _Shift(coarse + best, float(np.std(own, ddof=1)) / _PIECES**0.5, explained, drift if matters else 0.0)


def _drift(misfit: Callable[[float], float], samples: float) -> float:
    """Return the drift between two clocks, s/s, that fits best; 0 if it is not significant. misfit: sum of squares as a
    function of the drift. samples: the number of independent residuals.
    """
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(misfit, bounds=(-_FASTEST, _FASTEST), method="bounded", options={"xatol": 1e-7})
    return float(found.x) if (misfit(0.0) - found.fun) * samples > _DRIFTS**2 * found.fun else 0.0


def _refined(misfits: Callable[[float], Array], shift: float, width: float) -> tuple[Array, float]:
    """Return each piece's best shift (pieces,), less the best shift of all pieces together, and the latter, s. misfits:
    function of the shift. shift, width: start and range of the search, s.
    """
    for _ in range(6):
        less, here, more = (misfits(shift + part * width) for part in (-1.0, 0.0, 1.0))
        slopes, bend = (more - less) / (2.0 * width), float((more + less - 2.0 * here).sum()) / width**2
        if not np.isfinite(bend) or bend <= 0.0:
            return np.full(_PIECES, np.inf) * np.resize([1.0, -1.0], _PIECES), shift
        shift += float(np.clip(-slopes.sum() / bend, -width, width))
        width *= 0.6
    return -slopes * _PIECES / bend, shift


def _coarse(step: float, time: Array, dtheta: Array, other: Array, torque: Array) -> tuple[float, float]:
    """Return the shift at which deflection and rate explain the largest fraction of the torque's power, and that
    fraction. step: resolution of the shift, s. other: the torque's times, s.
    """
    from scipy.signal import correlate

    angle, load = (_even(step, at, values) for at, values in ((time, dtheta), (other, torque)))
    ones = np.ones_like(load)
    power, both = (correlate(np.ones_like(angle), one, method="fft") for one in (load**2, ones))
    with np.errstate(all="ignore"):
        shares = sum(
            correlate(one, load, method="fft") ** 2 / correlate(one**2, ones, method="fft") / power
            for one in (angle, np.gradient(angle, step))
        )
    shares = np.where(both > _COMMON * min(len(angle), len(load)), np.nan_to_num(shares), 0.0)
    best = int(np.argmax(shares))
    return float(time[0] + (best - len(load) + 1) * step - other[0]), float(shares[best])


def _even(step: float, time: Array, values: Array) -> Array:
    grid = np.arange(time[0], time[-1], step)
    found = np.interp(grid, time, values)
    return np.asarray(found - found.mean())


def _filtered(
    step: float, time: Array, dtheta: Array, other: Array, torque: Array
) -> tuple[Array, Array, Callable[..., Array], float]:
    """Return common times (k,), the torque (k,) there, the deflection as a spline, and the highest frequency, Hz.

    One low-pass filter removes from both what lies above their common band. step: s. other: the torque's times, s.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, csd, sosfiltfilt

    grid = np.arange(max(time[0], other[0]), min(time[-1], other[-1]), step)
    load, angle = CubicSpline(other, torque)(grid), CubicSpline(time, dtheta)(grid)
    frequency, cross = csd(angle, load, 1.0 / step, nperseg=max(256, len(grid) // 8), detrend="linear")
    power = np.cumsum(np.abs(cross) * frequency)
    highest = _ABOVE * float(frequency[np.searchsorted(power, _EXCITED * power[-1])])
    if highest < 0.45 / step:
        sections = butter(4, highest, fs=1.0 / step, output="sos")
        load, angle = (sosfiltfilt(sections, one) for one in (load, angle))
    ends = int(2.0 * _AROUND / highest / step) + 1
    return grid[ends:-ends], load[ends:-ends], CubicSpline(grid, angle), highest
