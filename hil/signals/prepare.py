"""Compute from a recording the signals that are identified: torque, deflection and rate at common times.

Rate and acceleration are slope and curvature of a local polynomial fitted to the deflection in a window centred on each
sample. The polynomial has no phase shift, and its gain differs from one by at most 0.03 % up to the frequency below
which 99 % of the rate's power lies; this frequency sets the windows (docs/rate.md explains it). Nothing else is
filtered: the torque in equation (1) is the torque that was read, and the motor's own torque is computed from the same
rate and acceleration. Raw channels are never altered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ga.arrays import Array, Index, Mask
from ga.model.trajectory import Motion
from ga.model.trajectory import joined as one_after_the_other
from hil.errors import Untrustworthy
from hil.recording.ahead import ahead
from hil.recording.reader import Recording
from hil.signals import slow_channel
from hil.signals.angle import unwrapped
from hil.signals.constants import DENSE_READINGS, FEWEST, MARGIN, PROBE
from hil.signals.defects import Defects, UsableRows, refuse_hopeless, refuse_without_rows, usable_rows
from hil.signals.rate.windows import Window, is_smooth, window_for
from hil.signals.slow_channel import Kind, Readings, Slower
from hil.signals.stamps import starts_within, stretches, within
from hil.signals.zero_steps import without, zero_steps
from hil.stand.file import StandTable
from hil.stand.transmission import Transmission


@dataclass(frozen=True, eq=False)
class Signals:
    """The motion of the joint and its torque.

    torque (n,): N m; if the deflection was low-passed, the torque passed the same filter. band: the excited band, Hz.
    rate_window: the width of the local polynomial, s. torque_from: "joint", "motor", "given" or, for several
    recordings, "mixed". window: the window of rate and acceleration; for several recordings that of the noisiest; None
    for signals that no recording gave. slower: the sensors that are slower than the ticks. command (n,): the set-points
    at these times, None if not recorded. unfiltered (n,): the torque as it was read, N m, if different. jerked (n,):
    which samples are beside a jump of the acceleration, so that rate or acceleration is unknown; None for none.
    imported: whether one of the recordings is an imported table. motor: inertia, kg m^2, and damping,
    N m s/rad, of the motor at the joint; 0 if unknown. row (n,): the rows of the recording that hold the samples.
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
    unfiltered: Array | None = None
    jerked: Mask | None = None
    imported: bool = False
    motor: tuple[float, float] = (0.0, 0.0)
    row: Index = field(default_factory=lambda: np.empty(0, np.int64))

    def __len__(self) -> int:
        return len(self.torque)

    def counted_from(self, reference: float) -> Signals:
        """Return the signals with deflections relative to `reference`, rad."""
        return self if reference == 0.0 else replace(self, motion=self.motion.shifted(reference))

    @property
    def rate_known(self) -> Mask:
        """Return for which samples (n,) the rate is known."""
        return np.ones(len(self), dtype=bool) if self.jerked is None else ~self.jerked

    @cached_property
    def smooth(self) -> Mask:
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
        row=np.concatenate([part.row for part in parts]),
        slower=tuple(dict.fromkeys(one for part in parts for one in part.slower)),
        command=np.concatenate(commands) if len(commands) == len(parts) else None,
        unfiltered=np.concatenate([part.as_read for part in parts]),
        jerked=None if known.all() else ~known,
        imported=any(part.imported for part in parts),
        motor=parts[0].motor if len({part.motor for part in parts}) == 1 else (0.0, 0.0),
    )


@dataclass(frozen=True, slots=True)
class _Columns:
    """The channels that are read: the deflection, and the torque of the motor or of the joint.

    own_time: whether the torque has its own stamps. imported: whether the channels are those of an imported table.
    torque, dtheta: how these channels show a sensor slower than the ticks.
    """

    stand: StandTable | None
    motor_side: bool
    own_time: bool
    imported: bool
    torque: Kind | None = None
    dtheta: Kind | None = None

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
        held = self.motor_side and recording.profile.get("mode") == "torque"
        return usable_rows(recording, start, stop, torque, own_time=self.own_time, held=held)

    def seeing(self, usable: UsableRows) -> tuple[_Columns, Window]:
        """Return the columns, with the sensors that these rows show to be slower than the ticks, and the windows."""
        torque = None if self.own_time else slow_channel.kind_of(usable.stamps[0], usable.torque)
        columns = replace(self, torque=torque, dtheta=slow_channel.kind_of(usable.stamps[0], usable.dtheta))
        return columns, _window(usable, columns)


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
    columns, window = columns.seeing(usable)
    found = _signals(usable, columns, window, rows := (0, len(recording)))
    if len(found) > FEWEST and (steps := zero_steps(found.motion, found.as_read - found.motion.known)):
        through = _at_joint(np.ones(1), columns)[0]
        torque, acting = (
            without(steps, "torque", usable.time, one, 1.0 / through) for one in (usable.torque, usable.acting)
        )
        dtheta = without(steps, "deflection", usable.time, usable.dtheta)
        usable = replace(usable, torque=torque, acting=acting, dtheta=dtheta)
        found = _signals(usable, columns, window, rows)
        found = replace(found, defects=replace(found.defects, zero_steps=tuple(steps)))
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
    own_time = not from_motor and present("joint_time")
    return _Columns(stand, from_motor, own_time=own_time, imported=recording.imported)


def _signals(usable: UsableRows, columns: _Columns, window: Window, rows: tuple[int, int]) -> Signals:
    """Return the signals of the usable rows within `rows` of the file. Other usable rows only complete the windows of
    these rows.
    """
    if len(usable.row) < FEWEST:
        return _nothing(usable, columns, window, rows)
    (stamps, _), angle = usable.stamps, usable.readings("deflection", columns.dtheta)
    time = angle.time
    dtheta, rate, acceleration = window.moved(time, angle.value)
    inside = within(usable.row[angle.row], rows)
    sound = window.sound(time) & np.isfinite(rate + acceleration)  # rows of a single stamp between two pauses have none
    own, over = _own_readings(usable, columns), usable.torque_unknown[angle.row]
    starts, long_enough = stretches(time, sound & ~over if own is None else sound, window.step)
    kept = long_enough & (inside if own is None else True)
    is_filtered = own is None and window.low_pass
    jerked = window.jerked(time, dtheta, rate, acceleration)[kept] if window.jerks else None
    motion = Motion(
        time[kept],
        dtheta[kept],
        rate[kept],
        acceleration[kept],
        _motor_share(rate, acceleration, columns)[kept],
        starts=starts_within(starts, kept),
        rate_noise=window.noise,
        behind=window if is_filtered else None,
    )
    # many readings in a period follow the steps of the torque
    acting = usable.torque if 1.0 / window.step > DENSE_READINGS * window.band[1] else usable.acting
    held = angle.row[kept]
    if own is None:
        torque = (window.alike(time, acting) if is_filtered else acting)[kept]
    else:
        angle_time, wanted = motion.time, within(usable.row[own.row], rows) & ~usable.torque_unknown[own.row]
        motion, torque, held = _at_readings(motion, own, wanted)
        jerked = None if jerked is None else _next_to_jump(jerked, angle_time, motion.time)
    return Signals(
        motion=motion,
        torque=_at_joint(torque, columns),
        defects=replace(
            usable.defects(rows),
            near_gaps=int(np.count_nonzero((inside & ~long_enough & ~over)[window.widest : len(time) - window.widest])),
            jerked=0 if jerked is None else int(np.count_nonzero(jerked)),
        ),
        band=window.band,
        rate_window=(2 * window.slope + 1) * window.step,
        window=window,
        torque_from=columns.torque_from,
        row=usable.row[held],
        slower=slow_channel.slower(columns.torque, own, columns.dtheta, angle, stamps),
        jerked=jerked,
        unfiltered=_at_joint(acting[kept], columns) if is_filtered else None,
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


def _at_readings(motion: Motion, own: Readings, wanted: Mask) -> tuple[Motion, Array, Index]:
    """Return the motion at torque readings, these readings, N m, and the samples that hold them.

    own: the sensor's own readings. wanted (m,): which of them are returned, if they lie within a piece.
    """
    own = replace(own, row=own.row[wanted], time=own.time[wanted], value=own.value[wanted])
    at = motion.at(own.time) if len(motion) else motion
    if len(at) < FEWEST:
        raise Untrustworthy(
            f"the torque cell gave only {len(at)} readings beside those of the angle, and Kc and Bc need at least "
            f"{FEWEST}: record for longer, or check whether the clock of the cell's times stands still"
        )
    place = np.searchsorted(own.time, at.time)
    return at, own.value[place], own.row[place]


def _next_to_jump(jerked: Mask, time: Array, reading_time: Array) -> Mask:
    """Return for each reading of the torque, at `reading_time` (m,), s, whether the acceleration jumps beside the
    sample of the angle before or after it.

    jerked (n,): whether it jumps beside a sample of the angle; time (n,): of these samples, s.
    """
    after = np.searchsorted(time, reading_time)
    return np.asarray(jerked[np.maximum(after - 1, 0)] | jerked[np.minimum(after, len(jerked) - 1)])


def _at_joint(torque: Array, columns: _Columns) -> Array:
    """Return a torque reading (n,), N m, as torque at the joint by equation (1), including the motor's own part."""
    return Transmission.of(columns.stand).torque(torque) if columns.motor_side and columns.stand else torque


def _motor_share(rate: Array, acceleration: Array, columns: _Columns) -> Array:
    """Return the motor's own part (n,), N m, of the torque at the joint."""
    if not columns.motor_side or columns.stand is None:
        return np.zeros_like(rate)
    return Transmission.of(columns.stand).motor_share(rate, acceleration)
