"""Select the rows of a recording that identification uses, and record why the others are left out."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Status
from hil.diagnostics import again
from hil.errors import Untrustworthy
from hil.recording.channels import LARGEST
from hil.recording.reader import Recording
from hil.signals import constants as c
from hil.signals import slow_channel
from hil.signals.angle import bursts, frozen, spikes
from hil.signals.slow_channel import Channel, Kind, Readings
from hil.signals.stamps import spread_stamps, within

Array = NDArray[np.float64]

_LEFT_OUT = ("lost", "not_numbers", "frozen", "spikes")  # rows


@dataclass(frozen=True, slots=True)
class Defects:
    """The numbers of rows of a recording that are not used, by reason.

    lost: rows without a reply. not_numbers: rows with a NaN. near_gaps: rows whose window contains a gap, without those
    at the two ends of the recording. coarse_clock: whether many rows shared a time stamp and were spread. frozen: rows
    with a constant angle while the torque changed. clipped: rows with the torque, or a neighbouring one, at the end of
    the sensor's range while the joint moved on. spikes: rows in which only the angle is wrong. wraps: jumps of the
    angle by a turn, which were removed. jerked: rows beside a jump of the acceleration, whose rate or acceleration is
    unknown.
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

    def __add__(self, other: Defects) -> Defects:
        return Defects(
            self.lost + other.lost,
            self.not_numbers + other.not_numbers,
            self.near_gaps + other.near_gaps,
            self.coarse_clock or other.coarse_clock,
            self.frozen + other.frozen,
            self.clipped + other.clipped,
            self.spikes + other.spikes,
            self.wraps + other.wraps,
            self.jerked + other.jerked,
        )


@dataclass(frozen=True, eq=False)
class UsableRows:
    """The n rows with a reply and only finite numbers: their index in the file, and the raw readings.

    torque_time: when the torque was read, s, NaN if unknown; equal to `time` unless another device read the torque.
    lost: indices of the rows without a reply. not_numbers: indices of the rows with a NaN. frozen, spikes: indices of
    the rows with a constant or a wrong angle. wraps: the number of jumps of the angle that were removed. clipped (n,):
    whether the torque was at the end of its range.
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
    spikes: NDArray[np.int64]
    clipped: NDArray[np.bool_]
    wraps: int = 0
    _read: dict[tuple[str, Kind | None], Readings] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def stamps(self) -> tuple[Array, bool]:
        """Return the time stamps (n,), s, with repeated stamps and bursts spread evenly, and whether many stamps were
        spread.
        """
        return spread_stamps(self.time)

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
        counts = {name: int(np.count_nonzero(within(place, rows))) for name, place in places.items()}
        return Defects(**counts, coarse_clock=self.stamps[1], wraps=self.wraps)


def usable_rows(
    recording: Recording, start: int, stop: int, torque_channel: str, *, rate: bool, own_time: bool
) -> UsableRows:
    """Return the usable rows from `start` to `stop`, with the torque of the channel `torque_channel`.

    rate: whether the recorded rate is read. own_time: whether another device read the torque, with its own stamps.
    """

    def channel(name: str) -> Array:
        return recording.channel(name, start, stop)

    answered = (channel("status").astype(np.int64) & int(Status.NO_REPLY | Status.BAD_REPLY)) == 0
    read = channel("read_time")
    time = np.where(np.isfinite(read), read, channel("time"))
    torque = channel(torque_channel)
    dtheta = channel("dtheta")
    reported_rate = channel("dtheta_dot") if rate else np.zeros_like(dtheta)
    good = answered.copy()
    for column in (time, torque, dtheta, reported_rate):
        good &= np.abs(column) < LARGEST  # false for NaN too
    stuck, odd = np.zeros((2, len(time)), dtype=bool)
    finite = slice(None) if good.all() else good  # mostly all are: nothing need be copied
    stuck[finite] = frozen(time[finite], dtheta[finite], torque[finite])
    odd[finite] = spikes(time[finite], dtheta[finite]) | bursts(time[finite], dtheta[finite], torque[finite])
    lost, not_numbers = np.flatnonzero(~answered), np.flatnonzero(answered & ~good)
    good &= ~stuck & ~odd
    kept = slice(None) if good.all() else good
    return UsableRows(
        row=np.flatnonzero(good) + start,
        time=time[kept],
        torque=torque[kept],
        dtheta=dtheta[kept],
        reported_rate=reported_rate[kept],
        torque_time=(channel("joint_time") if own_time else time)[kept],
        lost=lost + start,
        not_numbers=not_numbers + start,
        frozen=np.flatnonzero(stuck) + start,
        clipped=clipped(dtheta[kept], torque[kept]),
        spikes=np.flatnonzero(odd) + start,
    )


def clipped(dtheta: Array, torque: Array) -> NDArray[np.bool_]:
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
        if (
            np.count_nonzero(at_end) >= c.FEWEST
            and episodes >= c.CLIPPED_TIMES
            and _goes_on(values, dtheta[at_end], slope)
        ):
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
    if np.ptp(time) == 0.0:
        raise Untrustworthy(f"{name}: every sample has the same time: correct the time stamps")
    if (step := float(np.ptp(time)) / len(time)) < c.SHORTEST_STEP:
        raise Untrustworthy(f"{name}: the samples are {step:.2g} s apart, which no recorder does: check --time-unit")
    if np.ptp(torque) < c.STILL_TORQUE:
        raise Untrustworthy(
            f"{name}: {where}the torque never changes: no Kc or Bc can be estimated; check the torque sensor and its "
            "unit"
        )
    if np.ptp(dtheta) < c.STILL_ANGLE:
        larger = again("record a motion of the joint", "--amplitude", imported=recording.imported)
        raise Untrustworthy(
            f"{name}: {where}the deflection never changes: no Kc or Bc can be estimated; {larger} or free the cable"
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
