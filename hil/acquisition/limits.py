"""The limits of a run: each has a name, gives the reason for which it ends a run, and defines how long it must be
exceeded.

All limits are at the joint in SI and come from the stand file. `Excess` decides how far and how long a reading may be
above a limit (docs/wiring.md). Values that are not finite are handled before any comparison, since NaN is never above a
limit.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from heapq import heappush, heappushpop
from typing import NamedTuple, Protocol

from drivers.servo import BadReply, Sample

_FAR_BEYOND, _BEYOND, _SLIGHTLY = 0.5, 0.1, 0.03  # above a limit, of it: in one reading, in three of ten, for `_LASTS`
_TIMES, _OF = 3, 10  # readings beyond a limit, or missing, among the last ones
_LASTS, _FORGET = 0.25, 10.0  # s slightly beyond a limit, which are forgotten after about so many s
_NAMED, _LEAST = 10, 1e-3  # readings above a limit, by at least this much of it, that are named at the end of a run
_NOISES, _NAMED_NOISES = 3.0, 4.0  # standard deviations of its noise, that a reading slightly beyond, or named, exceeds
_NEGLIGIBLE = 1e-4  # s slightly beyond a limit, at which they are forgotten
_LATEST = 251  # readings above a limit whose noise is estimated
_LONGEST = 0.05  # s of one reading that count
_COOL_START, _COOL_RUN = 15.0, 5.0  # degC below the limit: refuse to start, stop
_FROZEN, _WARMING = 300.0, 0.5  # s of the same temperature while the torque is above this share of its limit
_SLOW_STEP = 30.0  # s between two temperatures, at least, where the winding comes to its balance
_SUPPLY = 0.3  # of the supply voltage at rest
_YIELDS = 0.2  # of the deflection limit, that a locked joint may turn
_BINOMIAL = (1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0)
_NOISE = 1.0 / (0.4307 * math.sqrt(sum(weight * weight for weight in _BINOMIAL)))
"""Standard deviation of white noise over the lowest third of the magnitudes of its sixth differences."""


class LimitReached(Exception):
    """A safety limit ended the run (exit status 4)."""


class AtJoint(NamedTuple):
    """The readings of one reply, converted to the joint: torque, N m; deflection, rad; velocity, rad/s; NaN if not
    read.
    """

    torque: float = math.nan
    dtheta: float = math.nan
    dtheta_dot: float = math.nan


class Limit(Protocol):
    """What every limit of a run provides. name: the limited quantity, for messages."""

    name: str

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Take the readings at rest, before the run. Raises LimitReached if the run must not begin."""

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check one reply of the drive. Raises LimitReached, and BadReply if a sensor is no longer reliable."""


class Persistence:
    """Tests whether a condition held in at least `_TIMES` of the last `_OF` readings.

    seen: the last readings as bits, 1 where the condition held. While `seen` is 0, a reading in which the condition
    does not hold changes nothing, so the call may be skipped.
    """

    __slots__ = ("seen",)

    def __init__(self) -> None:
        self.seen = 0

    def __call__(self, now: bool) -> bool:
        """Add a reading, in which the condition holds if `now`. Return whether it held in `_TIMES` of the last `_OF`
        readings.
        """
        self.seen = (self.seen << 1 | now) & ((1 << _OF) - 1)
        return now and self.seen.bit_count() >= _TIMES


class Excess:
    """The readings of one quantity above its limit. limit: largest allowed magnitude. count: the value of one
    count, NaN if not known. recent: the last readings, to which the caller adds each one.

    Their noise is estimated from the sixth differences of seven readings in a row: in a motion that is sampled ten
    times a cycle, they contain 0.2 % of the motion. The lowest third of their magnitudes is used, because those of a
    step or a gap are large. rows: number of readings above; first: time of the first one, s;
    largest: the largest excesses as shares of the limit, as a heap.
    """

    def __init__(self, limit: float, count: float) -> None:
        self.recent: deque[float] = deque(maxlen=len(_BINOMIAL))
        self.rows, self.first = 0, math.nan
        self.largest: list[float] = []
        self._limit = limit
        self._rounding = 0.5 * count / limit if count > 0.0 else 0.0  # false for a NaN
        self._clearly = Persistence()
        self._changes: deque[float] = deque(maxlen=_LATEST)  # magnitudes of the sixth differences
        self._lasted = 0.0  # s slightly beyond

    @property
    def settled(self) -> bool:
        """Return whether no reading was beyond the limit of late."""
        return not self._clearly.seen and not self._lasted

    def ends(self, size: float, t: float, passed: float) -> bool:
        """Return whether the reading of magnitude `size` at time `t`, s, ends the run. passed: s since the last one."""
        beyond = size / self._limit - 1.0
        if beyond > 0.0:
            self._add(beyond, t)
        slightly = beyond > _SLIGHTLY and beyond > _NOISES * self._noise + self._rounding
        if self._lasted or slightly:
            passed = min(passed, _LONGEST) if passed > 0.0 else 0.0  # false for a NaN
            self._lasted = self._lasted * (1.0 - passed / _FORGET) + (passed if slightly else 0.0)
            self._lasted = self._lasted if self._lasted > _NEGLIGIBLE else 0.0
        return self._clearly(beyond > _BEYOND) or beyond > _FAR_BEYOND or self._lasted > _LASTS

    def lasting(self) -> bool:
        """Return whether enough readings were above the limit, by more than their noise, to be named at the end."""
        least = max(_LEAST, _NAMED_NOISES * self._noise + self._rounding)
        return len(self.largest) == _NAMED and self.largest[0] > least

    @property
    def _noise(self) -> float:
        """The standard deviation of the readings' noise, as a share of the limit; 0 if it is not known."""
        return _NOISE * sorted(self._changes)[len(self._changes) // 3] / self._limit if self._changes else 0.0

    def _add(self, beyond: float, t: float) -> None:
        if not self.rows:
            self.first = t
        self.rows += 1
        (heappush if len(self.largest) < _NAMED else heappushpop)(self.largest, beyond)
        if len(self.recent) == len(_BINOMIAL):
            change = sum(weight * value for weight, value in zip(_BINOMIAL, self.recent, strict=True))
            if math.isfinite(change):
                self._changes.append(abs(change))


class Presence:
    """Checks that a quantity which was read at rest is still read during the run: without the reading its limit is
    blind.

    name: the quantity, for messages. expected: whether the quantity was read at rest.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._missing = Persistence()
        self.expected = False

    @property
    def settled(self) -> bool:
        """Return whether none of the last `_OF` readings is missing."""
        return not self._missing.seen

    def check(self, value: float) -> bool:
        """Return whether `value` is a reading, not NaN. Raises BadReply if the reading was missing `_TIMES` times
        recently.
        """
        present = math.isfinite(value)
        if (self._missing.seen or not present) and self._missing(not present) and self.expected:
            raise BadReply(f"the {self._name} was missing from {_TIMES} replies: check its sensor and cable")
        return present


class Level:
    """The limit on the magnitude of torque, deflection or velocity at the joint.

    field: index of the quantity in `AtJoint`. unit: of the quantity. limit: largest allowed magnitude.
    count: the value of one count, NaN if not known.
    """

    def __init__(self, name: str, field: int, unit: str, limit: float, count: float = math.nan) -> None:
        self.name = name
        self._field, self._unit, self._limit = field, unit, limit
        self._present = Presence(name)
        self._excess = Excess(limit, count)
        self._recent = self._excess.recent.append
        self._last = math.nan
        self._settled = False  # whether nothing was missing or above the limit of late

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Note whether the quantity is read at rest: from then on it must be read."""
        del samples
        self._present.expected = any(math.isfinite(one[self._field]) for one in at_joint)

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check one reply. Raises LimitReached if the quantity exceeds its limit, BadReply if it is missing
        repeatedly.
        """
        value = at_joint[self._field]
        self._recent(value)
        if self._settled and -self._limit <= value <= self._limit:  # false for a NaN
            self._last = sample.t
            return
        self._check_closely(value, sample)
        self._settled = self._present.settled and self._excess.settled

    def exceeded(self, start: float) -> str:
        """Return by how much, in how many rows and since when the quantity was above its limit, "" if it was not or by
        its noise only. start: of the run, s.
        """
        excess = self._excess
        if not excess.lasting():
            return ""
        return (
            f"the {self.name} was above its limit of {self._limit:g} {self._unit} in {excess.rows} rows from "
            f"{excess.first - start:.3g} s on, by {max(excess.largest) * 100.0:.2g} % at most"
        )

    def _check_closely(self, value: float, sample: Sample) -> None:
        passed, self._last = sample.t - self._last, sample.t
        if not self._present.check(value):
            return
        if self._excess.ends(abs(value), sample.t, passed):
            raise LimitReached(
                f"the {self.name} reached {abs(value):.3g} {self._unit}; its limit is {self._limit:g}: "
                "lower --amplitude or change --band"
            )


class Temperature:
    """Check that the winding's temperature, degC, stays below its limit and changes while the motor is loaded.

    A constant reading is possible in thermal equilibrium. Before equilibrium, a coarsely rounded reading changes more
    and more slowly: its last step takes at least ln 2 of the time constant, which is minutes for a motor's housing. A
    reading that changed faster than this and then stays constant is frozen.
    """

    name = "temperature"

    def __init__(self, limit: float, torque: float) -> None:
        self._limit = limit
        self._loaded = _WARMING * torque
        self._present = Presence(self.name)
        self._same, self._before = math.nan, math.nan
        self._loaded_for, self._last = 0.0, math.nan
        self._changed, self._balanced = math.nan, False

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Note whether a temperature is read at rest. Raises LimitReached if the winding is too warm to begin."""
        del at_joint
        temperatures = [sample.temperature for sample in samples if math.isfinite(sample.temperature)]
        self._present.expected = bool(temperatures)
        if temperatures and temperatures[-1] > self._limit - _COOL_START:
            raise LimitReached(
                f"the winding is at {temperatures[-1]:.0f} degC, within {_COOL_START:.0f} of its limit of "
                f"{self._limit:.0f}: let it cool down first"
            )

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check the temperature in one reply. Raises LimitReached if too high, BadReply if missing or frozen."""
        value = sample.temperature
        if value == self._same and -self._loaded <= at_joint.torque <= self._loaded and self._present.settled:
            self._last = sample.t  # it was below its limit, and need not change while the motor is idle
            return
        if not self._present.check(value):
            return
        if value > self._limit - _COOL_RUN:
            raise LimitReached(f"the winding reached {value:.0f} degC; its limit is {self._limit:.0f}: cool it down")
        passed, self._last = sample.t - self._last, sample.t
        if value != self._same:
            if value != self._before:  # back and forth between two readings is one step
                self._balanced = sample.t - self._changed >= _SLOW_STEP  # the first reading is no step
                self._changed = sample.t
            self._same, self._before, self._loaded_for = value, self._same, 0.0
        elif abs(at_joint.torque) > self._loaded:
            self._loaded_for += min(passed, _LONGEST)
            if self._loaded_for > _FROZEN and not self._balanced:
                raise BadReply(
                    f"the temperature stayed at {value:g} degC in {_FROZEN:.0f} s under load: its sensor is frozen, "
                    "and the winding may be hot"
                )


class Supply:
    """Check that the drive's supply voltage stays close to the voltage at rest."""

    name = "voltage"

    def __init__(self) -> None:
        self._at_rest = math.nan
        self._away = Persistence()

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Take the supply voltage at rest, with which later voltages are compared."""
        del at_joint
        self._at_rest = next((one.voltage for one in reversed(samples) if math.isfinite(one.voltage)), math.nan)

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check the supply voltage in one reply."""
        del at_joint
        away = abs(sample.voltage - self._at_rest) > _SUPPLY * self._at_rest  # false where one is NaN
        if (away or self._away.seen) and self._away(away):
            raise LimitReached(
                f"the supply voltage went from {self._at_rest:.3g} V at rest to {sample.voltage:.3g} V: the torque is "
                "not what was commanded; use a supply with more current, or with a brake resistor"
            )


class Lock:
    """Check that the locked joint does not turn, if the joint's angle is measured. limit: largest allowed deflection,
    rad.
    """

    name = "lock"

    def __init__(self, limit: float) -> None:
        self._most = _YIELDS * limit
        self._at_rest = math.nan
        self._turned = Persistence()

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Take the joint's angle at rest."""
        del at_joint
        angles = [one.joint_position for one in samples if math.isfinite(one.joint_position)]
        self._at_rest = angles[-1] if angles else math.nan

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check the joint's angle in one reply."""
        del at_joint
        turned = abs(sample.joint_position - self._at_rest)
        moved = turned > self._most  # false where one is NaN
        if (moved or self._turned.seen) and self._turned(moved):
            raise LimitReached(
                f"the joint turned by {turned:.2g} rad: it is not locked, so Kc would be too small; lock it"
            )
