"""From a recording to what the search takes: torque, deflection and rate on one time base.

The rate is the slope of a local cubic fitted to the deflection over a window centred on each sample: no phase shift,
and a gain within 0.5 % of one up to the frequency below which 95 % of the rate's power lies, which sets the window.
Torque inferred from the motor through equation (1) has the same local cubic on every term and on the deflection, so
that whatever the window does to one side it does to the other. Raw channels are never altered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from drivers.servo import Status
from hil.errors import Untrustworthy
from hil.stand import StandTable
from hil.store import Recording

Array = NDArray[np.float64]

_FEWEST = 16  # samples, below which nothing is concluded
_COARSE = 0.05  # share of repeated stamps from which a clock is called coarse
_GAIN = 0.995  # of the rate, at the upper end of the band
_LOW_SHARE, _HIGH_SHARE = 0.01, 0.95  # of the power of deflection and rate: the ends of the band
_PROBE = 1 << 20  # rows that show how a recording is to be read
_MARGIN = 256  # rows beyond the windows of a block, for what is lost among them
_WIDEST = 250  # samples on each side of a window
_DEGREE = 3
_ARRAYS = ("time", "torque", "dtheta", "dtheta_dot")


@dataclass(frozen=True, slots=True)
class Signals:
    """Equal-length (n,) arrays: time s, torque N m, dtheta rad, dtheta_dot rad/s, all at the joint.

    lost: replies that never came. not_numbers: rows dropped for a NaN. near_gaps: rows dropped since their window
    spans a gap. coarse_clock: whether repeated stamps were spread. band: Hz, what moved. rate_window: s, the width of
    the local cubic, 0 where the rate was given. torque_from: "joint", "motor" or "given".
    """

    time: Array
    torque: Array
    dtheta: Array
    dtheta_dot: Array
    lost: int
    not_numbers: int
    near_gaps: int
    coarse_clock: bool
    band: tuple[float, float]
    rate_window: float
    torque_from: str

    def __len__(self) -> int:
        return len(self.time)

    def thinned(self, every: int) -> Signals:
        """The same with every `every`-th sample only; what is counted stays counted."""
        arrays = {name: getattr(self, name)[::every] for name in _ARRAYS}
        return replace(self, **arrays)


def joined(parts: list[Signals]) -> Signals:
    """The signals of several recordings, or of the blocks of one, one after the other."""
    return Signals(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS},
        lost=sum(part.lost for part in parts),
        not_numbers=sum(part.not_numbers for part in parts),
        near_gaps=sum(part.near_gaps for part in parts),
        coarse_clock=any(part.coarse_clock for part in parts),
        band=(min(part.band[0] for part in parts), max(part.band[1] for part in parts)),
        rate_window=max(part.rate_window for part in parts),
        torque_from=parts[0].torque_from if len({part.torque_from for part in parts}) == 1 else "mixed",
    )


@dataclass(frozen=True, slots=True)
class _Source:
    """How a recording is read: torque from the motor's side or not, the rate as it came or from the deflection."""

    stand: StandTable | None
    motor_side: bool
    given_rate: bool


@dataclass(frozen=True, slots=True)
class _Usable:
    """The rows (n,) that were answered and are numbers: their place in the file and what was read, torque raw.

    lost, not_numbers: the places of the rows that were not answered, and of those that hold a NaN.
    """

    row: NDArray[np.int64]
    time: Array
    torque: Array
    dtheta: Array
    reported_rate: Array
    lost: NDArray[np.int64]
    not_numbers: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Window:
    """The local cubic for a recording: samples a side, the usual step between two, s, and the band it serves, Hz."""

    half: int
    step: float
    band: tuple[float, float]


def prepare(recording: Recording, stand: StandTable | None) -> Signals:
    """The signals of a recording made on `stand` (None: its torque column is taken as it is).

    Raises Untrustworthy where nothing can be concluded: too few rows, nothing moved, time going backwards.
    """
    source = _source_of(recording, stand)
    usable = _usable(recording, source, 0, len(recording))
    _refuse_hopeless(recording, usable)
    time, coarse = spread_stamps(usable.time)
    usable = replace(usable, time=time)
    return _signals(usable, source, _window_for(usable), (0, len(recording)), coarse=coarse)


def stream(recording: Recording, stand: StandTable | None, block: int = 1 << 18) -> Iterator[Signals]:
    """What `prepare` gives, `block` rows at a time, for recordings that do not fit in memory.

    The rate's window is set by the first million rows. Each block is worked out with enough rows of its neighbours for
    every window to be whole. Raises Untrustworthy as `prepare` does, for what the first million rows show.
    """
    source = _source_of(recording, stand)
    first = _usable(recording, source, 0, min(_PROBE, len(recording)))
    _refuse_hopeless(recording, first)
    window = _window_for(replace(first, time=spread_stamps(first.time)[0]))
    margin = 4 * window.half + _MARGIN  # the acceleration is the slope of a slope, and some rows are lost
    for start in range(0, len(recording), block):
        stop = min(start + block, len(recording))
        usable = _usable(recording, source, max(0, start - margin), min(stop + margin, len(recording)))
        time, coarse = spread_stamps(usable.time)
        yield _signals(replace(usable, time=time), source, window, (start, stop), coarse=coarse)


def _source_of(recording: Recording, stand: StandTable | None) -> _Source:
    def present(name: str) -> bool:
        return bool(np.isfinite(recording.channel(name, 0, _PROBE)).any())

    from_motor = stand is not None and stand.torque_source == "motor" and present("motor_torque")
    return _Source(stand, from_motor, present("dtheta_dot") and not present("motor_position"))


def _usable(recording: Recording, source: _Source, start: int, stop: int) -> _Usable:
    def channel(name: str) -> Array:
        return recording.channel(name, start, stop)

    answered = (channel("status").astype(np.int64) & int(Status.NO_REPLY | Status.BAD_REPLY)) == 0
    read = channel("read_time")
    time = np.where(np.isfinite(read), read, channel("time"))
    torque = channel("motor_torque" if source.motor_side else "torque")
    dtheta = channel("dtheta")
    rate = channel("dtheta_dot") if source.given_rate else np.zeros_like(dtheta)
    good = answered & np.isfinite(time) & np.isfinite(torque) & np.isfinite(dtheta) & np.isfinite(rate)
    return _Usable(
        row=np.flatnonzero(good) + start,
        time=time[good],
        torque=torque[good],
        dtheta=dtheta[good],
        reported_rate=rate[good],
        lost=np.flatnonzero(~answered) + start,
        not_numbers=np.flatnonzero(answered & ~good) + start,
    )


def _window_for(usable: _Usable) -> _Window:
    band = excited_band(usable.time, usable.dtheta)
    return _Window(window_half(usable.time, band[1]), float(np.median(np.diff(usable.time))), band)


def _signals(usable: _Usable, source: _Source, window: _Window, rows: tuple[int, int], *, coarse: bool) -> Signals:
    """The signals of the usable rows that lie within `rows` of the file; the others serve their windows only."""
    time, torque, dtheta, rate = usable.time, usable.torque, usable.dtheta, usable.reported_rate
    sound = np.ones(len(time), dtype=bool)
    if not source.given_rate:
        smooth, rate, span = local_cubic(time, dtheta, window.half)
        sound = span <= 1.5 * (2 * window.half) * window.step
        if source.motor_side and source.stand is not None:
            torque = _at_joint(time, torque, rate, window.half, source.stand)
            dtheta = smooth
    inside = _within(usable.row, rows)
    kept = sound & inside
    return Signals(
        time=time[kept],
        torque=torque[kept],
        dtheta=dtheta[kept],
        dtheta_dot=rate[kept],
        lost=int(np.count_nonzero(_within(usable.lost, rows))),
        not_numbers=int(np.count_nonzero(_within(usable.not_numbers, rows))),
        near_gaps=int(np.count_nonzero(inside & ~sound)),
        coarse_clock=coarse,
        band=window.band,
        rate_window=0.0 if source.given_rate else (2 * window.half + 1) * window.step,
        torque_from="motor" if source.motor_side else ("given" if source.stand is None else "joint"),
    )


def _within(row: NDArray[np.int64], rows: tuple[int, int]) -> NDArray[np.bool_]:
    return (row >= rows[0]) & (row < rows[1])


def _at_joint(time: Array, motor_torque: Array, rate: Array, half: int, stand: StandTable) -> Array:
    """Equation (1): the coupling's torque (n,) N m from the motor's, which moves with the deflection."""
    ratio = stand.gear_ratio
    acceleration = local_cubic(time, rate, half)[1]  # a cubic's own curvature has a gain far below its slope's
    smooth = local_cubic(time, motor_torque, half)[0]
    return ratio * (smooth - stand.motor_inertia * ratio * acceleration - stand.motor_damping * ratio * rate)


def _refuse_hopeless(recording: Recording, usable: _Usable) -> None:
    name, time, dtheta = recording.path, usable.time, usable.dtheta
    if len(time) < _FEWEST:
        raise Untrustworthy(f"{name} holds {len(time)} usable sample(s) of {len(recording)}: record at least {_FEWEST}")
    backwards = np.flatnonzero(np.diff(time) < 0.0)
    if backwards.size:
        raise Untrustworthy(f"{name}: time goes backwards after usable row {int(backwards[0])}: mend the stamps first")
    if np.ptp(time) == 0.0:
        raise Untrustworthy(f"{name}: every sample has the same time: mend the stamps first")
    if np.ptp(dtheta) == 0.0:
        raise Untrustworthy(f"{name}: the deflection never changes: nothing moved; raise --amplitude or free the cable")


def spread_stamps(time: Array) -> tuple[Array, bool]:
    """Stamps (n,) s with the repeats of a coarse clock spread evenly up to the next stamp, and whether any were.

    A clock that ticks every 15.6 ms gives several rows one stamp; their order is known and their spacing is even to
    within the loop's own jitter. The rows of the last stamp continue at the rate of the ones before.
    """
    starts = np.flatnonzero(np.concatenate(([True], np.diff(time) > 0.0)))
    if len(time) - len(starts) == 0:
        return time, False
    rows = np.arange(len(time), dtype=np.float64)
    last, before = starts[-1], starts[max(0, len(starts) - 50)]
    pace = (time[last] - time[before]) / max(last - before, 1)
    anchors = np.append(starts.astype(np.float64), len(time))
    at_anchors = np.append(time[starts], time[last] + pace * (len(time) - last))
    return np.interp(rows, anchors, at_anchors), (len(time) - len(starts)) > _COARSE * len(time)


def excited_band(time: Array, dtheta: Array) -> tuple[float, float]:
    """The band, Hz, in which the deflection (n,) rad moved, above its own noise.

    From 1 % of the deflection's power at the lower end to 95 % of the rate's at the upper. The noise floor is the
    median density in the upper half of the spectrum.
    """
    count = len(time)
    uniform = np.interp(np.linspace(time[0], time[-1], count), time, dtheta)
    step = (time[-1] - time[0]) / (count - 1)
    spectrum = np.abs(np.fft.rfft((uniform - uniform.mean()) * np.hanning(count))) ** 2
    frequency = np.fft.rfftfreq(count, step)
    density = np.convolve(spectrum, np.full(5, 0.2), mode="same")
    floor = float(np.median(density[len(density) // 2 :]))
    moved = np.where(density > 10.0 * floor, density - floor, 0.0)[1:]
    if not moved.any():
        return float(frequency[1]), float(frequency[-1])
    power, rate_power = np.cumsum(moved), np.cumsum(moved * frequency[1:] ** 2)
    low = int(np.searchsorted(power, _LOW_SHARE * power[-1]))
    high = int(np.searchsorted(rate_power, _HIGH_SHARE * rate_power[-1]))
    return float(frequency[1 + low]), float(frequency[1 + max(low, high)])


def window_half(time: Array, highest: float) -> int:
    """The widest window, in samples on each side, whose rate has a gain within 0.5 % of one at `highest` Hz."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    widest = max(2, min(_WIDEST, (len(time) - 1) // 4))
    half = 2
    while half < widest and rate_gain(half + 1, highest * step) >= _GAIN:
        half += 1
    return half


def rate_gain(half: int, cycles: float) -> float:
    """Gain of the local cubic's slope at `cycles` periods a sample, for an even grid and `half` samples a side."""
    offsets = np.arange(-half, half + 1, dtype=np.float64)
    slope = np.linalg.pinv(np.vander(offsets / half, _DEGREE + 1, increasing=True))[1] / half
    omega = 2.0 * np.pi * cycles
    return float(slope @ np.sin(omega * offsets)) / omega


def local_cubic(time: Array, values: Array, half: int) -> tuple[Array, Array, Array]:
    """Value and slope at every sample of the cubic that fits its window best, and the window's span in s.

    time (n,) s, need not be even; values (n,). A window is the sample and `half` neighbours a side; at the ends it is
    the first or last 2*half+1 samples, evaluated off its centre. All results (n,).
    """
    width = 2 * half + 1
    starts = np.clip(np.arange(len(time)) - half, 0, len(time) - width)
    times, rows = sliding_window_view(time, width), sliding_window_view(values, width)
    parts = [
        _cubic_block(time[block], times[starts[block]], rows[starts[block]])
        for block in np.array_split(np.arange(len(time)), 1 + len(time) * width // 2**21)
    ]
    value, slope, span = (np.concatenate(column) for column in zip(*parts, strict=True))
    return value, slope, span


def _cubic_block(at: Array, times: Array, rows: Array) -> tuple[Array, Array, Array]:
    """`local_cubic` for windows (b, w) around the times `at` (b,)."""
    span = times[:, -1] - times[:, 0]
    scale = 0.5 * span
    offset = (times - at[:, None]) / scale[:, None]
    base = rows.mean(axis=1)
    powers = [np.ones_like(offset)]
    for _ in range(_DEGREE):
        powers.append(powers[-1] * offset)
    design = np.stack(powers, axis=-1)
    transposed = np.swapaxes(design, 1, 2)
    right = transposed @ (rows - base[:, None])[..., None]
    coefficients = np.linalg.solve(transposed @ design, right)[..., 0]
    return coefficients[:, 0] + base, coefficients[:, 1] / scale, span
