"""From a recording to what the search takes: torque, deflection and rate on one time base.

Rate and acceleration are slope and curvature of a local polynomial fitted to the deflection over a window centred on
each sample: no phase shift, and a gain within 0.03 % of one up to the frequency below which 99 % of the rate's power
lies, which sets the windows (docs/rate.md says why). Nothing else is filtered: in equation (1) too the torque stays as
it was read, and what the motor itself takes of it is worked out from the same rate and acceleration. Raw channels are
never altered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Status
from ga.model.trajectory import Motion
from hil.errors import Untrustworthy
from hil.recording.reader import Recording
from hil.signals.joint_time import is_fresh, looked_up
from hil.signals.savitzky_golay import kernel, local_polynomial, widest
from hil.stand.file import StandTable
from hil.stand.transmission import Transmission

Array = NDArray[np.float64]

_FEWEST = 16  # samples, below which nothing is concluded
_COARSE = 0.05  # share of repeated stamps from which a clock is called coarse
_GAIN_ERROR = 3e-4  # of rate and acceleration, at the upper end of the band

_NOISE = 0.01  # of the rate that moved: so much noise in it takes 0.01 % off Bc
_FAST = 0.9  # quantile of the speed from which on a sample is a fast one
_NARROWEST = 6  # samples on each side of a window
_LOW_SHARE, _HIGH_SHARE = 0.01, 0.99  # of the power of deflection and rate: the ends of the band
_PARTS = 20  # windows side by side that a recording has room for, so that few rows lie near its ends
_FADE = 0.02  # of a recording at each end
_APART = 4.0  # usual steps between two samples from which on they are of two stretches
_SHORTEST = 8  # samples of a stretch, below which nothing is interpolated on it
_PROBE = 1 << 20  # rows that show how a recording is to be read
_MARGIN = 256  # rows beyond the windows of a block, for what is lost among them
_WIDEST = 250  # samples on each side of a window
_ARRAYS = ("time", "torque", "dtheta", "dtheta_dot", "dtheta_ddot", "known")


@dataclass(frozen=True, slots=True)
class Signals:
    """Equal-length (n,) arrays, all at the joint: time s, torque N m as it was read, dtheta rad, dtheta_dot rad/s,
    dtheta_ddot rad/s^2, known N m, what of the torque is not the coupling's: the motor's own in equation (1).

    starts: where a stretch without a gap begins, of one recording. lost: replies that never came. not_numbers: rows
    dropped for a NaN. near_gaps: rows dropped since their window spans a gap; those at the very ends, whose window
    would too, are not counted. coarse_clock: whether repeated stamps were spread. band: Hz, what moved. rate_window:
    s, the width of the local polynomial, 0 where the rate was given; rate_noise: rad/s, what of the rate is noise,
    None where that is not known. torque_from: "joint", "motor" or "given".
    """

    time: Array
    torque: Array
    dtheta: Array
    dtheta_dot: Array
    dtheta_ddot: Array
    known: Array
    starts: tuple[int, ...]
    lost: int
    not_numbers: int
    near_gaps: int
    coarse_clock: bool
    band: tuple[float, float]
    rate_window: float
    rate_noise: float | None
    torque_from: str

    def __len__(self) -> int:
        return len(self.time)

    @property
    def motion(self) -> Motion:
        """How the joint moved, as the models take it."""
        return Motion(
            self.time,
            self.dtheta,
            self.dtheta_dot,
            self.dtheta_ddot,
            self.known,
            starts=self.starts,
            rate_noise=self.rate_noise,
        )

    @property
    def coupling_torque(self) -> Array:
        """The torque in the coupling, (n,) N m: what was read without what is known of it."""
        return self.torque - self.known

    def thinned(self, every: int) -> Signals:
        """The same with every `every`-th sample only; what is counted stays counted."""
        arrays = {name: getattr(self, name)[::every].copy() for name in _ARRAYS}  # a view would hold all of it
        return replace(self, starts=tuple(-(-start // every) for start in self.starts), **arrays)


def joined(parts: list[Signals]) -> Signals:
    """The signals of several recordings, or of the blocks of one, one after the other."""
    lengths = np.cumsum([0, *(len(part) for part in parts[:-1])])
    noises = [part.rate_noise for part in parts if part.rate_noise is not None]
    return Signals(
        starts=tuple(int(length) + start for length, part in zip(lengths, parts, strict=True) for start in part.starts),
        rate_noise=max(noises) if len(noises) == len(parts) else None,
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
    """How a recording is read: torque from the motor's side or not, the rate as it came or from the deflection, and
    whether the torque has times of its own."""

    stand: StandTable | None
    motor_side: bool
    given_rate: bool
    own_time: bool


@dataclass(frozen=True, slots=True)
class _Usable:
    """The rows (n,) that were answered and are numbers: their place in the file and what was read, torque raw.

    torque_time: s, when the torque was read, NaN where that is not known: `time` unless another device read it.
    lost, not_numbers: the places of the rows that were not answered, and of those that hold a NaN.
    """

    row: NDArray[np.int64]
    time: Array
    torque: Array
    dtheta: Array
    reported_rate: Array
    torque_time: Array
    lost: NDArray[np.int64]
    not_numbers: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Window:
    """The local polynomials for a recording: neighbours a side for the slope and for the curvature, the usual step
    between two samples, s, the band they serve, Hz, and the slope's noise, rad/s."""

    slope: int
    curvature: int
    step: float
    band: tuple[float, float]
    noise: float

    @property
    def widest(self) -> int:
        return max(self.slope, self.curvature)


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
    margin = 2 * window.widest + _MARGIN  # some rows are lost
    for start in range(0, len(recording), block):
        stop = min(start + block, len(recording))
        usable = _usable(recording, source, max(0, start - margin), min(stop + margin, len(recording)))
        time, coarse = spread_stamps(usable.time)
        yield _signals(replace(usable, time=time), source, window, (start, stop), coarse=coarse)


def glimpse(recording: Recording, stand: StandTable | None, parts: int = 16, rows: int = 1 << 14) -> Signals:
    """Some stretches of a long recording, evenly spread. Raises Untrustworthy as `stream` does."""
    source = _source_of(recording, stand)
    first = _usable(recording, source, 0, min(_PROBE, len(recording)))
    _refuse_hopeless(recording, first)
    window = _window_for(replace(first, time=spread_stamps(first.time)[0]))
    found = []
    for start in np.linspace(0, max(0, len(recording) - rows), parts).astype(int).tolist():
        usable = _usable(recording, source, start, min(start + rows, len(recording)))
        time, coarse = spread_stamps(usable.time)
        found.append(_signals(replace(usable, time=time), source, window, (0, len(recording)), coarse=coarse))
    return joined(found)


def _source_of(recording: Recording, stand: StandTable | None) -> _Source:
    def present(name: str) -> bool:
        return bool(np.isfinite(recording.channel(name, 0, _PROBE)).any())

    from_motor = stand is not None and stand.torque_source == "motor" and present("motor_torque")
    given_rate = present("dtheta_dot") and not present("motor_position")
    return _Source(stand, from_motor, given_rate, own_time=not from_motor and present("joint_time"))


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
        torque_time=(channel("joint_time") if source.own_time else time)[good],
        lost=np.flatnonzero(~answered) + start,
        not_numbers=np.flatnonzero(answered & ~good) + start,
    )


def _window_for(usable: _Usable) -> _Window:
    """The widest windows the band allows, the slope's made narrower while its noise still does not matter."""
    time, step = usable.time, float(np.median(np.diff(usable.time)))
    band = excited_band(time, usable.dtheta)
    slope, curvature = windows(time, band[1])
    rate = local_polynomial(time, usable.dtheta, slope)[1]
    left = np.abs(usable.dtheta - local_polynomial(time, usable.dtheta, _NARROWEST)[0])
    left *= 1.4826 / np.sqrt(1.0 - float(kernel(_NARROWEST, 0)[_NARROWEST]))
    fast = np.abs(rate) >= np.quantile(np.abs(rate), _FAST)  # there stamps that are wrong make noise too
    noise, fastest = float(np.median(left)), float(np.median(left[fast]))
    slope = max(narrowed(slope, step, noise, rate), narrowed(slope, step, fastest, rate[fast]))
    return _Window(slope, curvature, step, band, noise * _amplified(slope, step))


def narrowed(slope: int, step: float, noise: float, rate: Array) -> int:
    """The narrowest window, neighbours a side, up to `slope` of them, in which the noise of the rate does not matter.

    step: s between two samples; noise: rad, standard deviation of the deflection's; rate (n,) rad/s. What a wide window
    smooths away, such as the kinks where friction holds the joint, is missing in Bc.
    """
    allowed = _NOISE * float(np.sqrt(np.mean(rate**2)))
    while slope > _NARROWEST and noise * _amplified(slope - 1, step) <= allowed:
        slope -= 1
    return slope


def _amplified(half: int, step: float) -> float:
    """The standard deviation of the slope, rad/s, for noise of 1 rad in the deflection."""
    return float(np.linalg.norm(kernel(half, 1))) / step


def _signals(usable: _Usable, source: _Source, window: _Window, rows: tuple[int, int], *, coarse: bool) -> Signals:
    """The signals of the usable rows that lie within `rows` of the file; the others serve their windows only."""
    time, dtheta = usable.time, usable.dtheta
    if source.given_rate:
        rate = usable.reported_rate
        acceleration = local_polynomial(time, rate, window.curvature)[1]
    else:
        rate = local_polynomial(time, dtheta, window.slope)[1]
        acceleration = local_polynomial(time, dtheta, window.curvature)[2]
    torque, known = _at_joint(usable.torque, rate, acceleration, source)
    inside = _within(usable.row, rows)
    sound = np.ones(len(time), dtype=bool) if source.given_rate else _is_sound(time, window)
    starts, long_enough = _stretches(time, sound, window.step)
    kept = long_enough & inside
    if source.own_time:
        kept &= is_fresh(usable.torque_time)
        at = usable.torque_time
        dtheta, rate = looked_up(at, time, dtheta, rate), looked_up(at, time, rate, acceleration)
        time, acceleration = at, np.interp(at, time, acceleration)
    return Signals(
        time=time[kept],
        torque=torque[kept],
        dtheta=dtheta[kept],
        dtheta_dot=rate[kept],
        dtheta_ddot=acceleration[kept],
        known=known[kept],
        starts=_starts_within(starts, kept),
        lost=int(np.count_nonzero(_within(usable.lost, rows))),
        not_numbers=int(np.count_nonzero(_within(usable.not_numbers, rows))),
        near_gaps=int(np.count_nonzero((inside & ~long_enough)[window.widest : len(time) - window.widest])),
        coarse_clock=coarse,
        band=window.band,
        rate_window=0.0 if source.given_rate else (2 * window.slope + 1) * window.step,
        rate_noise=None if source.given_rate else window.noise,
        torque_from="motor" if source.motor_side else ("given" if source.stand is None else "joint"),
    )


def windows(time: Array, highest: float) -> tuple[int, int]:
    """The widest local polynomials, neighbours a side, that give slope and curvature of motion up to `highest` Hz."""
    cycles = highest * (time[-1] - time[0]) / (len(time) - 1)
    most = min(_WIDEST, (len(time) - 1) // _PARTS)
    slope, curvature = (widest(order, cycles, most, _GAIN_ERROR) for order in (1, 2))
    return slope, min(slope, curvature)


def _is_sound(time: Array, window: _Window) -> NDArray[np.bool_]:
    """Whether (n,) the window of a sample is whole: centred on it, and without a gap in it."""
    width, half = 2 * window.widest, window.widest
    sound = np.zeros(len(time), dtype=bool)
    sound[half : len(time) - half] = time[width:] - time[:-width] <= 1.5 * width * window.step
    return sound


def _stretches(time: Array, sound: NDArray[np.bool_], step: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Where a stretch of sound samples without a gap begins, and which samples (n,) are of one that is long enough."""
    places = np.flatnonzero(sound)
    breaks = np.flatnonzero((np.diff(places) > 1) & (np.diff(time[places]) > _APART * step)) + 1
    parts = [part for part in np.split(places, breaks) if len(part) >= _SHORTEST]
    kept = np.zeros(len(time), dtype=bool)
    for part in parts:
        kept[part] = True
    return np.array([part[0] for part in parts], dtype=np.int64), kept


def _starts_within(starts: NDArray[np.int64], kept: NDArray[np.bool_]) -> tuple[int, ...]:
    """The same starts, counted in the samples that are kept."""
    counted = np.unique(np.concatenate([[0], np.cumsum(kept)[starts] - kept[starts]]))
    return tuple(counted[counted < np.count_nonzero(kept)].tolist()) or (0,)


def _within(row: NDArray[np.int64], rows: tuple[int, int]) -> NDArray[np.bool_]:
    return (row >= rows[0]) & (row < rows[1])


def _at_joint(torque: Array, rate: Array, acceleration: Array, source: _Source) -> tuple[Array, Array]:
    """Return the torque (n,) N m at the joint, and the motor's own part of it, by equation (1)."""
    if not source.motor_side or source.stand is None:
        return torque, np.zeros_like(torque)
    way = Transmission.of(source.stand)
    return way.torque(torque), way.motor_share(rate, acceleration)


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

    From 1 % of the deflection's power at the lower end to 99 % of the rate's at the upper. The noise floor is the
    median density in the upper half of the spectrum. Only the very ends are faded: a chirp is fastest at its end.
    """
    count = len(time)
    uniform = np.interp(np.linspace(time[0], time[-1], count), time, dtheta)
    step = (time[-1] - time[0]) / (count - 1)
    fade = np.sin(0.5 * np.pi * np.minimum(1.0, (np.arange(count) + 0.5) / (_FADE * count))) ** 2
    spectrum = np.abs(np.fft.rfft((uniform - uniform.mean()) * fade * fade[::-1])) ** 2
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
