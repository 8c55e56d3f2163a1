"""Select the rows of a recording that identification uses, and record why the others are left out."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from drivers.servo import Status
from ga.arrays import Array, Index, Mask
from hil.diagnostics import again
from hil.errors import Untrustworthy
from hil.recording.channels import LARGEST
from hil.recording.reader import Recording
from hil.signals import constants as c
from hil.signals import slow_channel
from hil.signals.angle import bursts, frozen, outliers, spikes, unwrapped
from hil.signals.held_torque import smooth_torque
from hil.signals.slow_channel import Channel, Kind, Readings
from hil.signals.stamps import mean_step, spread_stamps, within
from hil.signals.zero_steps import ZeroStep, stuck_torque

_LEFT_OUT = ("lost", "not_numbers", "frozen", "spikes")  # rows


@dataclass(frozen=True, slots=True)
class Defects:
    """The numbers of rows of a recording that are not used, by reason.

    lost: rows without a reply. not_numbers: rows with a NaN. near_gaps: rows whose window contains a gap, without those
    at the two ends of the recording. coarse_clock: whether many rows shared a time stamp and were spread. frozen: rows
    with a constant angle while the torque changed. clipped: rows with the torque, or a neighbouring one, at the end of
    the sensor's range while the joint moved on. spikes: rows in which only the angle is wrong. wraps: jumps of the
    angle by a turn, which were removed. jerked: rows beside a jump of the acceleration, whose rate or acceleration is
    unknown. wrong_torques: single wrong readings of the torque, N m. stuck_torques: times, s, of rows with a
    constant torque while the joint moved on. zero_steps: steps of a zero, which were subtracted.
    """

    lost: int = 0
    not_numbers: int = 0
    near_gaps: int = 0
    coarse_clock: bool = False
    frozen: int = 0
    clipped: int = 0
    spikes: int = 0
    wraps: int = 0
    jerked: int = 0
    wrong_torques: tuple[float, ...] = ()
    stuck_torques: tuple[float, ...] = ()
    zero_steps: tuple[ZeroStep, ...] = ()

    def __add__(self, other: Defects) -> Defects:
        pairs = zip(astuple(self), astuple(other), strict=True)
        return Defects(*(type(one)(one + another) for one, another in pairs))  # of two flags: whether one is set


@dataclass(frozen=True, eq=False)
class UsableRows:
    """The n rows with a reply and only finite numbers: their index in the file, and the raw readings.

    acting: `torque`, or its smooth part where a drive holds its torque set-points, N m (`held_torque`).
    torque_time: when the torque was read, s, NaN if unknown; equal to `time` unless another device read the torque.
    lost: indices of the rows without a reply. not_numbers: indices of the rows with a NaN. frozen, spikes: indices of
    the rows with a constant or a wrong angle. wraps: the number of jumps of the angle that were removed. clipped (n,):
    whether the torque was at the end of its range. stuck (n,): whether it was constant while the joint moved on. wrong
    (n,): whether it was a single wrong reading; `torque` has an interpolated one there, and wrong_torques (k,) what was
    read.
    """

    row: Index
    time: Array
    torque: Array
    acting: Array
    dtheta: Array
    torque_time: Array
    lost: Index
    not_numbers: Index
    frozen: Index
    spikes: Index
    clipped: Mask
    stuck: Mask
    wrong: Mask
    wrong_torques: Array
    wraps: int = 0
    _read: dict[tuple[str, Kind | None], Readings] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def stamps(self) -> tuple[Array, bool]:
        """Return the time stamps (n,), s, with repeated stamps and bursts spread evenly, and whether many stamps were
        spread.
        """
        return spread_stamps(self.time)

    @property
    def torque_unknown(self) -> Mask:
        """Return in which rows (n,) the torque was wrong, stuck, or at the end of its range."""
        return self.clipped | self.stuck | self.wrong

    def readings(self, channel: Channel, kind: Kind | None) -> Readings:
        """Return the readings of a channel: all its values, or for a slower sensor only the sensor's own readings.

        kind: how the channel shows a slower sensor. The result is stored, because windows and signals both need it, and
        to find the pace of a slow sensor takes time.
        """
        if (channel, kind) not in self._read:
            (time, _), values = self.stamps, self.torque if channel == "torque" else self.dtheta
            every = Readings(np.arange(len(time)), time, values)
            self._read[channel, kind] = every if kind is None else slow_channel.readings(time, values, kind)
        return self._read[channel, kind]

    def defects(self, rows: tuple[int, int]) -> Defects:
        """Return how many rows within `rows` of the file are not used. Rows that only a window rejects are not
        included.
        """
        places = {name: getattr(self, name) for name in _LEFT_OUT} | {"clipped": self.row[self.clipped]}
        counts: dict[str, Any] = {name: int(np.count_nonzero(within(place, rows))) for name, place in places.items()}
        wrong = tuple(self.wrong_torques[within(self.row[self.wrong], rows)].tolist())
        stuck = tuple(self.time[self.stuck & within(self.row, rows)].tolist())
        counts |= {"wraps": self.wraps, "coarse_clock": self.stamps[1], "wrong_torques": wrong, "stuck_torques": stuck}
        return Defects(**counts)


def usable_rows(
    recording: Recording, start: int, stop: int, torque_channel: str, *, own_time: bool, held: bool
) -> UsableRows:
    """Return the usable rows from `start` to `stop`, with the torque of the channel `torque_channel`.

    own_time: whether another device read the torque, with its own stamps.
    held: whether the command is a torque of the motor, which its drive holds.
    """

    def channel(name: str) -> Array:
        return recording.channel(name, start, stop)

    answered = (channel("status").astype(np.int64) & int(Status.NO_REPLY | Status.BAD_REPLY)) == 0
    read = channel("read_time")
    time = np.where(np.isfinite(read), read, channel("time"))
    torque = channel(torque_channel)
    dtheta = channel("dtheta")
    good = answered.copy()
    for column in (time, torque, dtheta):
        good &= np.abs(column) < LARGEST  # false for NaN too
    stuck, odd = np.zeros((2, len(time)), dtype=bool)
    finite = slice(None) if good.all() else good  # mostly all are: nothing need be copied
    stuck[finite] = frozen(time[finite], dtheta[finite], torque[finite])
    odd[finite] = spikes(time[finite], dtheta[finite]) | bursts(time[finite], dtheta[finite], torque[finite])
    lost, not_numbers = np.flatnonzero(~answered), np.flatnonzero(answered & ~good)
    good &= ~stuck & ~odd
    kept = slice(None) if good.all() else good
    stamps, read, angle = time[kept], torque[kept], dtheta[kept]
    wrong = outliers(stamps, read, unwrapped(angle, read)[0])
    mended = np.where(wrong, np.interp(stamps, stamps[~wrong], read[~wrong]), read) if wrong.any() else read
    acting = np.where(wrong, mended, smooth_torque(torque, channel("command"))[kept]) if held else mended
    return UsableRows(
        row=np.flatnonzero(good) + start,
        time=stamps,
        torque=mended,
        acting=acting,
        dtheta=angle,
        torque_time=(channel("joint_time") if own_time else time)[kept],
        lost=lost + start,
        not_numbers=not_numbers + start,
        frozen=np.flatnonzero(stuck) + start,
        clipped=clipped(angle, mended),
        stuck=stuck_torque(stamps, mended, angle) & ~wrong,
        wrong=wrong,
        wrong_torques=read[wrong],
        spikes=np.flatnonzero(odd) + start,
    )


def clipped(dtheta: Array, torque: Array) -> Mask:
    """Return which readings (n,) of a torque, N m, are at the end of the sensor's range, or beside such a reading.

    dtheta (n,): deflection, rad. At the end of the range many readings are equal to the last digit, again and again,
    while the deflection changes by as much as several levels of the torque. A joint that rests or reverses there does
    not move.
    """
    found, spread = np.zeros(len(torque), dtype=bool), float(np.var(dtheta)) if len(torque) else 0.0
    slope = abs(float(np.mean((dtheta - dtheta.mean()) * torque))) / spread if spread else 0.0
    for values in (torque, -torque):
        at_end = values == values.max(initial=-np.inf)
        episodes = np.count_nonzero(at_end[1:] > at_end[:-1])
        if np.count_nonzero(at_end) >= c.FEWEST and episodes >= c.REPEATED and _goes_on(values, dtheta[at_end], slope):
            found |= at_end
    return np.convolve(found, np.ones(2 * c.CLIPPED_BESIDE + 1), "same") > 0.5 if found.any() else found


def _goes_on(torque: Array, dtheta: Array, slope: float) -> bool:
    """Return whether the joint moves on at the end of the sensor's range.

    torque (n,): the highest torques, N m. dtheta (n,): their deflections, rad, which must span several torque levels.
    slope: torque over deflection, N m/rad.
    """
    levels, counts = np.unique(torque, return_counts=True)
    below, step = counts[-c.CLIPPED_LEVELS : -1], np.diff(levels[-c.CLIPPED_LEVELS :])
    low, high = np.quantile(dtheta, (1.0 - c.MOST, c.MOST))
    return bool(
        len(below)
        and counts[-1] > c.CLIPPED_COUNT * below.max()
        and slope * (high - low) > c.CLIPPED_MOTION * float(np.median(step))
    )


def refuse_hopeless(recording: Recording, time: Array, torque: Array, dtheta: Array, where: str = "") -> None:
    """Raise Untrustworthy if the usable rows (n,) of a recording, SI, are too few, out of order or constant.

    where: a description of these rows for the message.
    """
    name, more = recording.name, "take a part with" if recording.window else "record"
    if len(time) < c.FEWEST:
        raise Untrustworthy(
            f"{name} holds {len(time)} usable sample(s) of {len(recording)}: {more} at least {c.FEWEST}"
        )
    backwards = np.flatnonzero(np.diff(time) < 0.0)
    if backwards.size:
        raise Untrustworthy(
            f"{name}: time goes backwards after usable row {int(backwards[0])}: correct the time stamps"
        )
    _refuse_coarse(name, time)
    step = mean_step(time)
    if step < c.STEPS[0]:
        raise Untrustworthy(f"{name}: the samples are {step:.2g} s apart, which no recorder does: check --time-unit")
    if step >= c.STEPS[1]:
        raise Untrustworthy(
            f"{name}: the samples are {step:.3g} s apart ({1.0 / step:.2g} Hz), too slow to show the damping of a "
            "joint: check --time-unit, or measure a slow torsion test with hil hysteresis"
        )
    if np.ptp(torque) < c.UNCHANGED:
        raise Untrustworthy(
            f"{name}: {where}the torque never changes: no Kc or Bc can be estimated; check the torque sensor and its "
            "unit"
        )
    if np.ptp(dtheta) < c.UNCHANGED:
        larger = again("record a motion of the joint", "--amplitude", imported=recording.imported)
        raise Untrustworthy(
            f"{name}: {where}the deflection never changes: no Kc or Bc can be estimated; {larger} or free the cable"
        )


def _refuse_coarse(name: str, time: Array) -> None:
    """Raise Untrustworthy if so many rows share one stamp (n,), s, that the times of the rows are unknown."""
    runs = np.diff(np.flatnonzero(np.diff(time, prepend=-np.inf, append=np.inf) > 0.0))
    count = int(runs.max())
    if count <= c.PACE_ROWS or (count <= c.MANY * len(time) and np.median(time[c.PACE_ROWS :] - time[: -c.PACE_ROWS])):
        return
    kind = "The stamps are whole seconds: when" if (time == np.round(time)).all() else "When"
    raise Untrustworthy(
        f"{name}: {count} successive rows share the time stamp {time[runs[: runs.argmax()].sum()]:.7g} s. {kind} each "
        "of them was read is unknown, and neither Kc nor Bc can be identified. Export the times with all digits and "
        "their fraction of a second, or leave these rows out"
    )


def refuse_without_rows(recording: Recording, left: int, defects: Defects) -> None:
    """Raise Untrustworthy if a recording has no usable row. The message states the most frequent reason.

    left: the number of usable rows. defects: the reasons for the others.
    """
    if left:
        return
    softer = again("drive with less torque", "--amplitude", imported=recording.imported)
    causes = [
        (defects.clipped, "have a torque at the end of its sensor's range", f"{softer}, or widen the sensor's range"),
        (defects.near_gaps, "lie beside a gap, so that they have no rate", "record without a pause"),
        (defects.lost, "are lost replies", "check cable and baud rate"),
        (defects.not_numbers, "hold no number", "look at them with hil export"),
        (defects.frozen, "have an angle that stood still", "check the encoder and its cable"),
    ]
    count, lack, remedy = max(causes, key=lambda cause: cause[0])
    why = f"{count} rows {lack}. To identify Kc and Bc, {remedy}" if count else "record for longer"
    raise Untrustworthy(f"{recording.name}: none of {len(recording)} rows can be used: {why}")
