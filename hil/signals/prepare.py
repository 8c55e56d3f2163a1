"""From a recording to the signals that are identified: torque, deflection and rate on one time base.

Rate and acceleration are slope and curvature of a local polynomial fitted to the deflection over a window centred on
each sample: no phase shift, and a gain within 0.03 % of one up to the frequency below which 99 % of the rate's power
lies, which sets the windows (docs/rate.md gives the reasons). Nothing else is filtered: in equation (1) too the torque
stays as it was read, and the motor's own torque is computed from the same rate and acceleration. Raw channels are never
altered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Status
from ga.model.trajectory import Motion
from hil.errors import Untrustworthy
from hil.recording.channels import LARGEST
from hil.recording.reader import Recording
from hil.signals.angle import frozen, unwrapped
from hil.signals.joint_time import interpolated, is_fresh
from hil.signals.savitzky_golay import local_polynomial
from hil.signals.windows import Window, window_for
from hil.stand.file import StandTable
from hil.stand.transmission import Transmission

Array = NDArray[np.float64]

_FINEST = 1e-9  # s between two samples
_STILL_ANGLE, _STILL_TORQUE = 1e-12, 1e-15  # rad and N m peak to peak, below which a reading never changes
_FEWEST = 16  # samples, below which nothing is concluded
_COARSE = 0.05  # share of repeated stamps above which a clock is called coarse
_APART = 4.0  # median steps between two samples above which they belong to two stretches
_SHORTEST = 8  # samples of a stretch, below which nothing is interpolated on it
_PROBE = 1 << 20  # rows from which the columns to read and the windows are chosen
_MARGIN = 256  # rows beyond the windows of a block, to replace those that were lost


@dataclass(frozen=True, slots=True)
class Defects:
    """Rows of a recording that are not used, and whether many shared a time stamp and were spread.

    lost: replies that never came. not_numbers: rows with a NaN. near_gaps: rows whose window spans a gap; those at the
    two ends of the recording are not counted. frozen: rows in which the angle stood still while the torque changed.
    wraps: jumps of the angle by a turn, which were taken back.
    """

    lost: int = 0
    not_numbers: int = 0
    near_gaps: int = 0
    coarse_clock: bool = False
    frozen: int = 0
    wraps: int = 0

    def __add__(self, other: Defects) -> Defects:
        return Defects(
            self.lost + other.lost,
            self.not_numbers + other.not_numbers,
            self.near_gaps + other.near_gaps,
            self.coarse_clock or other.coarse_clock,
            self.frozen + other.frozen,
            self.wraps + other.wraps,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """How the joint moved, and its torque (n,), N m, as it was read.

    band: Hz, the excited band. rate_window: s, the width of the local polynomial, 0 where the rate was recorded.
    torque_from: "joint", "motor", "given" or, of several, "mixed". window: that rate and acceleration were computed in,
    of several that of the noisiest, None where the rate was recorded.
    """

    motion: Motion
    torque: Array
    defects: Defects
    band: tuple[float, float]
    rate_window: float
    torque_from: str
    window: Window | None = None

    def __len__(self) -> int:
        return len(self.torque)

    def counted_from(self, reference: float) -> Signals:
        """Return the signals with deflections from `reference`, rad."""
        if reference == 0.0:
            return self
        return replace(self, motion=replace(self.motion, dtheta=self.motion.dtheta - reference, part_of=None))

    @property
    def coupling_torque(self) -> Array:
        """The torque in the coupling, (n,) N m: the reading without the motor's own torque."""
        return self.torque - self.motion.known


def joined(parts: list[Signals]) -> Signals:
    """Return the signals of several recordings, or of the blocks of one, one after the other."""
    motions = [part.motion for part in parts]
    lengths = np.cumsum([0, *(len(part) for part in parts[:-1])])
    noises = [motion.rate_noise for motion in motions if motion.rate_noise is not None]
    return Signals(
        motion=Motion(
            np.concatenate([motion.time for motion in motions]),
            np.concatenate([motion.dtheta for motion in motions]),
            np.concatenate([motion.dtheta_dot for motion in motions]),
            np.concatenate([motion.dtheta_ddot for motion in motions]),
            np.concatenate([motion.known for motion in motions]),
            starts=tuple(
                int(length) + start for length, motion in zip(lengths, motions, strict=True) for start in motion.starts
            ),
            rate_noise=max(noises) if len(noises) == len(motions) else None,
        ),
        torque=np.concatenate([part.torque for part in parts]),
        defects=sum((part.defects for part in parts), Defects()),
        band=(min(part.band[0] for part in parts), max(part.band[1] for part in parts)),
        rate_window=max(part.rate_window for part in parts),
        window=max((part.window for part in parts if part.window), key=lambda one: one.of_deflection, default=None),
        torque_from=parts[0].torque_from if len({part.torque_from for part in parts}) == 1 else "mixed",
    )


@dataclass(frozen=True, slots=True)
class _Columns:
    """Which channels are read: the motor's torque or the joint's, a recorded rate or the deflection's slope, and
    whether the torque has times of its own."""

    stand: StandTable | None
    motor_side: bool
    rate_given: bool
    own_time: bool


@dataclass(frozen=True, slots=True)
class _Usable:
    """The rows (n,) that hold a reply and only finite numbers: their place in the file and the raw readings.

    torque_time: s, when the torque was read, NaN where that is not known: `time` unless another device read it.
    lost, not_numbers: the places of the rows without a reply, and of those with a NaN; frozen: of those in which the
    angle stood still while the torque changed. wraps: jumps of the angle by a turn that were taken back.
    """

    row: NDArray[np.int64]
    time: Array
    torque: Array
    dtheta: Array
    reported_rate: Array
    torque_time: Array
    lost: NDArray[np.int64]
    not_numbers: NDArray[np.int64]
    frozen: NDArray[np.int64]
    wraps: int = 0


def prepare(recording: Recording, stand: StandTable | None) -> Signals:
    """Return the signals of a recording made on `stand` (None: its torque column is used as it is).

    Raises Untrustworthy for too few rows, a constant deflection, and time stamps that decrease or never change.
    """
    columns = _columns_of(recording, stand)
    usable = _usable(recording, columns, 0, len(recording))
    _refuse_hopeless(recording, usable)
    # of a part of a recording it would not be known by how many turns it is off
    dtheta, wraps = unwrapped(usable.dtheta)
    usable = replace(usable, dtheta=dtheta, wraps=wraps)
    window = window_for(spread_stamps(usable.time)[0], usable.dtheta, usable.torque)
    return _signals(usable, columns, window, (0, len(recording)))


def stream(recording: Recording, stand: StandTable | None, block: int = 1 << 18) -> Iterator[Signals]:
    """Yield the signals of `prepare`, `block` rows at a time, for recordings that do not fit in memory.

    The first million rows set the rate's window. Each block is computed with enough rows of its neighbours for every
    window to be whole. Raises Untrustworthy as `prepare`, judged by the first million rows.
    """
    columns = _columns_of(recording, stand)
    window = _probed(recording, columns)
    margin = 2 * window.widest + _MARGIN  # lost rows take room too
    for start in range(0, len(recording), block):
        stop = min(start + block, len(recording))
        usable = _usable(recording, columns, max(0, start - margin), min(stop + margin, len(recording)))
        yield _signals(usable, columns, window, (start, stop))


def glimpse(recording: Recording, stand: StandTable | None, parts: int = 16, rows: int = 1 << 14) -> list[Signals]:
    """Return some stretches of a long recording, evenly spread. Raises Untrustworthy as `stream`."""
    columns = _columns_of(recording, stand)
    window = _probed(recording, columns)
    parts = max(1, min(parts, len(recording) // rows))  # samples that were seen twice would count as more evidence
    starts = np.linspace(0, max(0, len(recording) - rows), parts).astype(int).tolist()
    stretches = (_usable(recording, columns, start, min(start + rows, len(recording))) for start in starts)
    return [_signals(usable, columns, window, (0, len(recording))) for usable in stretches]


def _probed(recording: Recording, columns: _Columns) -> Window:
    first = _usable(recording, columns, 0, min(_PROBE, len(recording)))
    _refuse_hopeless(recording, first)
    return window_for(spread_stamps(first.time)[0], first.dtheta, first.torque)


def _columns_of(recording: Recording, stand: StandTable | None) -> _Columns:
    def present(name: str) -> bool:
        return bool(np.isfinite(recording.channel(name, 0, _PROBE)).any())

    from_motor = stand is not None and stand.torque_source == "motor" and present("motor_torque")
    rate_given = present("dtheta_dot") and not present("motor_position")
    return _Columns(stand, from_motor, rate_given, own_time=not from_motor and present("joint_time"))


def _usable(recording: Recording, columns: _Columns, start: int, stop: int) -> _Usable:
    def channel(name: str) -> Array:
        return recording.channel(name, start, stop)

    answered = (channel("status").astype(np.int64) & int(Status.NO_REPLY | Status.BAD_REPLY)) == 0
    read = channel("read_time")
    time = np.where(np.isfinite(read), read, channel("time"))
    torque = channel("motor_torque" if columns.motor_side else "torque")
    dtheta = channel("dtheta")
    rate = channel("dtheta_dot") if columns.rate_given else np.zeros_like(dtheta)
    good = answered.copy()
    for column in (time, torque, dtheta, rate):
        good &= np.abs(column) < LARGEST  # false for NaN too
    stuck = np.zeros(len(time), dtype=bool)
    stuck[good] = frozen(time[good], dtheta[good], torque[good])
    lost, not_numbers = np.flatnonzero(~answered), np.flatnonzero(answered & ~good)
    good &= ~stuck
    return _Usable(
        row=np.flatnonzero(good) + start,
        time=time[good],
        torque=torque[good],
        dtheta=dtheta[good],
        reported_rate=rate[good],
        torque_time=(channel("joint_time") if columns.own_time else time)[good],
        lost=lost + start,
        not_numbers=not_numbers + start,
        frozen=np.flatnonzero(stuck) + start,
    )


def _signals(usable: _Usable, columns: _Columns, window: Window, rows: tuple[int, int]) -> Signals:
    """Return the signals of the usable rows within `rows` of the file; the other rows only fill their windows."""
    (time, coarse), dtheta = spread_stamps(usable.time), usable.dtheta
    if columns.rate_given:
        rate = usable.reported_rate
        acceleration = local_polynomial(time, rate, window.curvature, 1)
    else:
        dtheta, rate, acceleration = window.moved(time, dtheta)
    torque, known = _at_joint(usable.torque, rate, acceleration, columns)
    inside = _within(usable.row, rows)
    sound = np.ones(len(time), dtype=bool) if columns.rate_given else window.sound(time)
    starts, long_enough = _stretches(time, sound, window.step)
    kept = long_enough & inside
    if columns.own_time:
        kept &= is_fresh(usable.torque_time)
        at = usable.torque_time
        dtheta, rate = interpolated(at, time, dtheta, rate), interpolated(at, time, rate, acceleration)
        time, acceleration = at, np.interp(at, time, acceleration)
    return Signals(
        motion=Motion(
            time[kept],
            dtheta[kept],
            rate[kept],
            acceleration[kept],
            known[kept],
            starts=_starts_within(starts, kept),
            rate_noise=None if columns.rate_given else window.noise,
        ),
        torque=torque[kept],
        defects=Defects(
            lost=int(np.count_nonzero(_within(usable.lost, rows))),
            not_numbers=int(np.count_nonzero(_within(usable.not_numbers, rows))),
            near_gaps=int(np.count_nonzero((inside & ~long_enough)[window.widest : len(time) - window.widest])),
            coarse_clock=coarse,
            frozen=int(np.count_nonzero(_within(usable.frozen, rows))),
            wraps=usable.wraps,
        ),
        band=window.band,
        rate_window=0.0 if columns.rate_given else (2 * window.slope + 1) * window.step,
        window=None if columns.rate_given else window,
        torque_from="motor" if columns.motor_side else ("given" if columns.stand is None else "joint"),
    )


def _stretches(time: Array, sound: NDArray[np.bool_], step: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return where each gapless stretch of sound samples begins, and which samples (n,) are in one long enough."""
    places = np.flatnonzero(sound)
    breaks = np.flatnonzero((np.diff(places) > 1) & (np.diff(time[places]) > _APART * step)) + 1
    parts = [part for part in np.split(places, breaks) if len(part) >= _SHORTEST]
    kept = np.zeros(len(time), dtype=bool)
    for part in parts:
        kept[part] = True
    return np.array([part[0] for part in parts], dtype=np.int64), kept


def _starts_within(starts: NDArray[np.int64], kept: NDArray[np.bool_]) -> tuple[int, ...]:
    """Return the starts as indices into the samples that are kept."""
    counted = np.unique(np.concatenate([[0], np.cumsum(kept)[starts] - kept[starts]]))
    return tuple(counted[counted < np.count_nonzero(kept)].tolist()) or (0,)


def _within(row: NDArray[np.int64], rows: tuple[int, int]) -> NDArray[np.bool_]:
    return (row >= rows[0]) & (row < rows[1])


def _at_joint(torque: Array, rate: Array, acceleration: Array, columns: _Columns) -> tuple[Array, Array]:
    """Return the torque (n,) N m at the joint, and the motor's own part of it, by equation (1)."""
    if not columns.motor_side or columns.stand is None:
        return torque, np.zeros_like(torque)
    way = Transmission.of(columns.stand)
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
    if (step := float(np.ptp(time)) / len(time)) < _FINEST:
        raise Untrustworthy(f"{name}: the samples are {step:.2g} s apart, which no recorder does: check --time-unit")
    if np.ptp(usable.torque) < _STILL_TORQUE:
        raise Untrustworthy(
            f"{name}: the torque never changes: no Kc or Bc can be estimated; check the torque sensor and its unit"
        )
    if np.ptp(dtheta) < _STILL_ANGLE:
        raise Untrustworthy(
            f"{name}: the deflection never changes: no Kc or Bc can be estimated; raise --amplitude or free the cable"
        )


def spread_stamps(time: Array) -> tuple[Array, bool]:
    """Return the stamps (n,) s with repeats spread evenly up to the next stamp, and whether repeats are many.

    A clock that ticks every 15.6 ms gives several rows one stamp; their order is known and their spacing is even to
    within the loop's own jitter. The rows of the last stamp continue at the rate of the rows before.
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
