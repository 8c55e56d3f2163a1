"""Compute from a recording the signals that are identified: torque, deflection and rate at common times.

Rate and acceleration are slope and curvature of a local polynomial fitted to the deflection in a window centred on each
sample. The polynomial has no phase shift, and its gain differs from one by at most 0.03 % up to the frequency below
which 99 % of the rate's power lies; this frequency sets the windows (docs/rate.md explains it). Nothing else is
filtered: the torque in equation (1) is the torque that was read, and the motor's own torque is computed from the same
rate and acceleration. Raw channels are never altered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ga.model.trajectory import Motion
from ga.model.trajectory import joined as one_after_the_other
from hil.errors import Untrustworthy
from hil.recording.ahead import ahead
from hil.recording.reader import Recording
from hil.signals import slow_channel
from hil.signals.angle import unwrapped
from hil.signals.constants import FEWEST, MARGIN, PROBE
from hil.signals.defects import Defects, UsableRows, refuse_hopeless, refuse_without_rows, usable_rows
from hil.signals.rate.own_rate import OwnRate, is_difference, refused_rate
from hil.signals.rate.savitzky_golay import local_polynomial
from hil.signals.rate.windows import Window, is_smooth, window_for
from hil.signals.slow_channel import Kind, Readings, Slower
from hil.signals.stamps import starts_within, stretches, within
from hil.stand.file import StandTable
from hil.stand.transmission import Transmission

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Signals:
    """The motion of the joint and its torque.

    torque (n,): N m; if the deflection was low-passed, the torque passed the same filter. band: the excited band, Hz.
    rate_window: the width of the local polynomial, s, 0 if the rate was recorded. torque_from: "joint", "motor",
    "given" or, for several recordings, "mixed". window: the window of rate and acceleration; for several recordings
    that of the noisiest; None if the rate was recorded. slower: the sensors that are slower than the ticks. command
    (n,): the set-points at these times, None if not recorded. refused_rate: how a recorded rate differs from the
    deflection's derivative, which is why it is not used. unfiltered (n,): the torque as it was read, N m, if different.
    jerked (n,): which samples are beside a jump of the acceleration, so that rate or acceleration is unknown; None for
    none. imported: whether one of the recordings is an imported table. motor: inertia, kg m^2, and damping,
    N m s/rad, of the motor at the joint; 0 if unknown.
    """

    motion: Motion
    torque: Array
    defects: Defects
    band: tuple[float, float]
    rate_window: float
    torque_from: str
    window: Window | None = None
    slower: tuple[Slower, ...] = ()
    command: Array | None = None
    refused_rate: OwnRate | None = None
    unfiltered: Array | None = None
    jerked: NDArray[np.bool_] | None = None
    imported: bool = False
    motor: tuple[float, float] = (0.0, 0.0)

    def __len__(self) -> int:
        return len(self.torque)

    def counted_from(self, reference: float) -> Signals:
        """Return the signals with deflections relative to `reference`, rad."""
        return self if reference == 0.0 else replace(self, motion=self.motion.shifted(reference))

    @property
    def rate_known(self) -> NDArray[np.bool_]:
        """Return for which samples (n,) the rate is known."""
        return np.ones(len(self), dtype=bool) if self.jerked is None else ~self.jerked

    @cached_property
    def smooth(self) -> NDArray[np.bool_]:
        """Return the samples (n,) whose rate hardly depends on the window that it is computed with. Beside a jump of
        the acceleration it depends on the window.
        """
        return is_smooth(self.motion, self.window)

    @property
    def as_read(self) -> Array:
        """Return the torque (n,), N m, as it was read."""
        return self.torque if self.unfiltered is None else self.unfiltered

    @property
    def coupling_torque(self) -> Array:
        """Return the torque in the coupling (n,), N m: the reading without the motor's own torque."""
        return self.torque - self.motion.known


def joined(parts: list[Signals]) -> Signals:
    """Return the signals of several recordings, or of several blocks of a recording, concatenated."""
    commands = [part.command for part in parts if part.command is not None]
    known = np.concatenate([part.rate_known for part in parts])
    return Signals(
        motion=one_after_the_other([part.motion for part in parts]),
        torque=np.concatenate([part.torque for part in parts]),
        defects=sum((part.defects for part in parts), Defects()),
        band=(min(part.band[0] for part in parts), max(part.band[1] for part in parts)),
        rate_window=max(part.rate_window for part in parts),
        window=max((part.window for part in parts if part.window), key=lambda one: one.of_deflection, default=None),
        torque_from=parts[0].torque_from if len({part.torque_from for part in parts}) == 1 else "mixed",
        slower=tuple(dict.fromkeys(one for part in parts for one in part.slower)),
        command=np.concatenate(commands) if len(commands) == len(parts) else None,
        unfiltered=np.concatenate([part.as_read for part in parts]),
        jerked=None if known.all() else ~known,
        imported=any(part.imported for part in parts),
        motor=parts[0].motor if len({part.motor for part in parts}) == 1 else (0.0, 0.0),
    )


@dataclass(frozen=True, slots=True)
class _Columns:
    """The channels that are read: torque of the motor or of the joint, and a recorded rate or the deflection's slope.

    own_time: whether the torque has its own stamps. imported: whether the channels are those of an imported table.
    torque, dtheta: how these channels show a sensor slower than the ticks. refused: why a recorded rate is not used.
    """

    stand: StandTable | None
    motor_side: bool
    rate_given: bool
    own_time: bool
    imported: bool
    torque: Kind | None = None
    dtheta: Kind | None = None
    refused: OwnRate | None = None

    @property
    def torque_from(self) -> str:
        """Return where the torque comes from: "joint", "motor" or "given"."""
        return "motor" if self.motor_side else ("given" if self.stand is None else "joint")

    @property
    def motor(self) -> tuple[float, float]:
        """Return the motor's inertia and damping at the joint."""
        through = Transmission(1.0) if self.stand is None else Transmission.of(self.stand)
        return through.motor_share(0.0, 1.0), through.motor_share(1.0, 0.0)

    def rows_of(self, recording: Recording, start: int, stop: int) -> UsableRows:
        """Return the usable rows from `start` to `stop`."""
        torque = "motor_torque" if self.motor_side else "torque"
        return usable_rows(recording, start, stop, torque, rate=self.rate_given, own_time=self.own_time)

    def seeing(self, usable: UsableRows) -> tuple[_Columns, Window]:
        """Return the columns and the windows for the usable rows.

        The columns are updated: these rows show which sensors are slower than the ticks, and whether the recorded rate
        is used.
        """
        columns = self._slower(usable)
        window = _window(usable, columns)
        if not columns.rate_given:
            return columns, window
        time = usable.stamps[0]
        derived = np.where(window.sound(time), window.moved(time, usable.dtheta)[1], np.nan)
        if is_difference(time, usable.dtheta, usable.reported_rate, derived):
            return replace(columns, rate_given=False), window
        refused = refused_rate(
            time, usable.torque, usable.dtheta, usable.reported_rate, derived, highest=window.band[1]
        )
        return replace(columns, rate_given=refused is None, refused=refused), window

    def _slower(self, usable: UsableRows) -> _Columns:
        torque = None if self.own_time else slow_channel.kind_of(usable.stamps[0], usable.torque)
        dtheta = slow_channel.kind_of(usable.stamps[0], usable.dtheta)
        return replace(self, torque=torque, dtheta=dtheta, rate_given=self.rate_given and dtheta is None)


def prepare(recording: Recording, stand: StandTable | None) -> Signals:
    """Return the signals of a recording made on `stand`. stand: None if there is no stand; the torque column is then
    used unchanged.

    Raises Untrustworthy for too few rows, a constant deflection, and time stamps that decrease or never change.
    """
    columns = _columns_of(recording, stand)
    usable = columns.rows_of(recording, 0, len(recording))
    refuse_hopeless(recording, usable.time, usable.torque, usable.dtheta)
    # of a part of a recording it would not be known by how many turns it is off
    dtheta, wraps = unwrapped(usable.dtheta, usable.torque)
    usable = replace(usable, dtheta=dtheta, wraps=wraps)
    found = _signals(usable, *columns.seeing(usable), (0, len(recording)))
    refuse_without_rows(recording, len(found), found.defects)
    return found


def refuse_at_rest(recording: Recording, signals: Signals) -> None:
    """Raise Untrustworthy if too few samples have a rate, or if torque or deflection is constant in the samples that
    have one.
    """
    known = signals.rate_known
    samples = signals.motion.time[known], signals.torque[known], signals.motion.dtheta[known]
    refuse_hopeless(recording, *samples, where="in the samples that have a rate, ")


class LongRecording:
    """A recording that is too long for memory, and whose signals are computed block by block.

    The first million rows set the window. Raises Untrustworthy if no signals can be computed from these rows.
    """

    def __init__(self, recording: Recording, stand: StandTable | None) -> None:
        columns = _columns_of(recording, stand)
        first = columns.rows_of(recording, 0, min(PROBE, len(recording)))
        refuse_hopeless(recording, first.time, first.torque, first.dtheta)
        self._recording = recording
        self._columns, self._window = columns.seeing(first)

    def glimpse(self, parts: int = 16, rows: int = 1 << 14) -> list[Signals]:
        """Return at most `parts` pieces of `rows` rows, spread evenly over the recording.

        Raises Untrustworthy if no row is usable.
        """
        length = len(self._recording)
        parts = max(1, min(parts, length // rows))  # samples that were seen twice would count as more evidence
        starts = np.linspace(0, max(0, length - rows), parts).astype(int).tolist()
        stretches = (self._columns.rows_of(self._recording, start, start + rows) for start in starts)
        found = [_signals(usable, self._columns, self._window, (0, length)) for usable in stretches]
        left = [one for one in found if len(one)]
        refuse_without_rows(self._recording, sum(len(one) for one in left), joined(found).defects)
        return left

    def stream(self, block: int = 1 << 18) -> Iterator[Signals]:
        """Yield the signals of `block` rows at a time. Neighbouring rows are read too, so that all windows are
        complete.
        """
        margin = 2 * self._window.widest + MARGIN  # lost rows take room too
        starts = range(0, len(self._recording), block)
        around = ((max(0, start - margin), start + block + margin) for start in starts)
        read = ahead(self._columns.rows_of(self._recording, *rows) for rows in around)
        for start, usable in zip(starts, read, strict=True):
            yield _signals(usable, self._columns, self._window, (start, start + block))


def _window(usable: UsableRows, columns: _Columns) -> Window:
    angle = usable.readings("deflection", columns.dtheta)
    own = _own_readings(usable, columns) if columns.torque or columns.own_time else None
    if own is None:
        return window_for(angle.time, angle.value, usable.torque[angle.row])
    return window_for(angle.time, angle.value, np.interp(angle.time, own.time, own.value), own)


def _own_readings(usable: UsableRows, columns: _Columns) -> Readings | None:
    """Return the torque sensor's own readings, N m, if they were not made at the ticks; else None."""
    if columns.own_time:
        return slow_channel.stamped(usable.torque_time, usable.torque)
    return usable.readings("torque", columns.torque) if columns.torque or columns.dtheta else None


def _columns_of(recording: Recording, stand: StandTable | None) -> _Columns:
    def present(name: str) -> bool:
        return bool(np.isfinite(recording.channel(name, 0, PROBE)).any())

    from_motor = stand is not None and stand.torque_source == "motor" and present("motor_torque")
    rate_given = present("dtheta_dot") and not present("motor_position")
    return _Columns(
        stand, from_motor, rate_given, own_time=not from_motor and present("joint_time"), imported=recording.imported
    )


def _signals(usable: UsableRows, columns: _Columns, window: Window, rows: tuple[int, int]) -> Signals:
    """Return the signals of the usable rows within `rows` of the file. Other usable rows only complete the windows of
    these rows.
    """
    if len(usable.row) < FEWEST:
        return _nothing(usable, columns, window, rows)
    (stamps, _), angle = usable.stamps, usable.readings("deflection", columns.dtheta)
    time, dtheta = angle.time, angle.value
    if columns.rate_given:
        rate = usable.reported_rate
        acceleration = local_polynomial(time, rate, window.curvature, 1)
    else:
        dtheta, rate, acceleration = window.moved(time, dtheta)
    known = _motor_share(rate, acceleration, columns)
    inside = within(usable.row[angle.row], rows)
    sound = window.has_acceleration(time) if columns.rate_given else window.sound(time)
    own, over = _own_readings(usable, columns), usable.clipped[angle.row]
    starts, long_enough = stretches(time, sound & ~over if own is None else sound, window.step)
    kept = long_enough & (inside if own is None else True)
    is_filtered = own is None and not columns.rate_given and window.low_pass
    jerks = not columns.rate_given and window.jerks
    jerked = window.jerked(time, dtheta, rate, acceleration)[kept] if jerks else None
    motion = Motion(
        time[kept],
        dtheta[kept],
        rate[kept],
        acceleration[kept],
        known[kept],
        starts=starts_within(starts, kept),
        rate_noise=None if columns.rate_given else window.noise,
        behind=window if is_filtered else None,
    )
    if own is None:
        torque = (window.alike(time, usable.torque) if is_filtered else usable.torque)[kept]
    else:
        angle_time = motion.time
        motion, torque = _at_readings(motion, own, within(usable.row[own.row], rows) & ~usable.clipped[own.row])
        jerked = None if jerked is None else _beside(jerked, angle_time, motion.time)
    return Signals(
        motion=motion,
        torque=_at_joint(torque, columns),
        defects=replace(
            usable.defects(rows),
            near_gaps=int(np.count_nonzero((inside & ~long_enough & ~over)[window.widest : len(time) - window.widest])),
            jerked=0 if jerked is None else int(np.count_nonzero(jerked)),
        ),
        band=window.band,
        rate_window=0.0 if columns.rate_given else (2 * window.slope + 1) * window.step,
        window=None if columns.rate_given else window,
        torque_from=columns.torque_from,
        slower=slow_channel.slower(columns.torque, own, columns.dtheta, angle, stamps),
        refused_rate=columns.refused,
        jerked=jerked,
        unfiltered=_at_joint(usable.torque[kept], columns) if is_filtered else None,
        imported=columns.imported,
        motor=columns.motor,
    )


def _nothing(usable: UsableRows, columns: _Columns, window: Window, rows: tuple[int, int]) -> Signals:
    """Return empty signals, for rows of which almost none is usable, as in a block without replies."""
    none, left = np.empty(0), int(np.count_nonzero(within(usable.row, rows)))
    return Signals(
        motion=Motion(none, none, none, none, none),
        torque=none,
        defects=replace(usable.defects(rows), near_gaps=left),
        band=window.band,
        rate_window=0.0,
        torque_from=columns.torque_from,
        motor=columns.motor,
    )


def _at_readings(motion: Motion, own: Readings, wanted: NDArray[np.bool_]) -> tuple[Motion, Array]:
    """Return the motion at torque readings, and these readings, N m.

    own: the sensor's own readings. wanted (m,): which of them are returned, if they lie within a piece.
    """
    own = replace(own, row=own.row[wanted], time=own.time[wanted], value=own.value[wanted])
    for is_last in (own.drifts == 0.0, True):
        at = motion.at(own.time) if len(motion) else motion
        if len(at) < FEWEST:
            raise Untrustworthy(
                f"the torque cell gave only {len(at)} readings beside those of the angle, and Kc and Bc need at least "
                f"{FEWEST}: record for longer, or check whether the clock of the cell's times stands still"
            )
        found = own.value[np.searchsorted(own.time, at.time)]
        if is_last:
            break
        own = replace(own, time=slow_channel.repaced(own, motion))
    return at, found


def _beside(jerked: NDArray[np.bool_], time: Array, wanted: Array) -> NDArray[np.bool_]:
    """Return for each wanted time (m,), s, whether one of the samples (n,) next to it is beside a jump of the
    acceleration.
    """
    after = np.searchsorted(time, wanted)
    return np.asarray(jerked[np.maximum(after - 1, 0)] | jerked[np.minimum(after, len(jerked) - 1)])


def _at_joint(torque: Array, columns: _Columns) -> Array:
    """Return a torque reading (n,), N m, as torque at the joint by equation (1), including the motor's own part."""
    return Transmission.of(columns.stand).torque(torque) if columns.motor_side and columns.stand else torque


def _motor_share(rate: Array, acceleration: Array, columns: _Columns) -> Array:
    """Return the motor's own part (n,), N m, of the torque at the joint."""
    if not columns.motor_side or columns.stand is None:
        return np.zeros_like(rate)
    return Transmission.of(columns.stand).motor_share(rate, acceleration)
