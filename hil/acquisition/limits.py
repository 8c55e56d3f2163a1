"""The limits of a run: each has a name, gives the reason for which it ends a run, and defines how long it must be
exceeded.

All limits are at the joint in SI and come from the stand file. A single reading far beyond a limit ends a run. A
reading slightly beyond a limit must occur again within a few readings, so that one wrong count does not end a
recording. Values that are not finite are handled before any comparison, since NaN is never above a limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from drivers.servo import BadReply, Sample

_TIMES, _OF = 3, 10  # readings beyond a limit, or missing, among the last ones
_SLIGHTLY, _BEYOND, _FAR_BEYOND = 1.03, 1.1, 1.5  # of a limit
_SLIGHTLY_FOR, _FORGET = 0.25, 10.0  # s slightly beyond a limit, which are forgotten after about so many s
_LONGEST = 0.05  # s of one reading that count
_COOL_START, _COOL_RUN = 15.0, 5.0  # degC below the limit: refuse to start, stop
_FROZEN, _WARMING = 300.0, 0.5  # s of the same temperature while the torque is above this share of its limit
_SLOW_STEP = 30.0  # s between two temperatures, at least, where the winding comes to its balance
_SUPPLY = 0.3  # of the supply voltage at rest
_YIELDS = 0.2  # of the deflection limit, that a locked joint may turn


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
    """

    def __init__(self, name: str, field: int, unit: str, limit: float) -> None:
        self.name = name
        self._field, self._unit, self._limit = field, unit, limit
        self._present = Presence(name)
        self._beyond = Persistence()
        self._last = math.nan
        self._spent = 0.0  # s slightly beyond
        self._settled = False  # whether nothing was missing or beyond of late
        self._slightly = _SLIGHTLY * limit

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Note whether the quantity is read at rest: from then on it must be read."""
        del samples
        self._present.expected = any(math.isfinite(one[self._field]) for one in at_joint)

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check one reply. Raises LimitReached if the quantity exceeds its limit, BadReply if it is missing
        repeatedly.
        """
        value = at_joint[self._field]
        if self._settled and -self._slightly < value < self._slightly:  # false for a NaN
            self._last = sample.t
            return
        self._check_closely(value, sample)
        self._settled = self._present.settled and not self._beyond.seen and not self._spent

    def _check_closely(self, value: float, sample: Sample) -> None:
        if not self._present.check(value):
            return
        size = abs(value) / self._limit
        if self._beyond(size > _BEYOND) or size > _FAR_BEYOND or self._stays(size > _SLIGHTLY, sample.t):
            raise LimitReached(
                f"the {self.name} reached {abs(value):.3g} {self._unit}; its limit is {self._limit:g}: "
                "lower --amplitude or change --band"
            )

    def _stays(self, beyond: bool, now: float) -> bool:
        passed, self._last = now - self._last, now
        if self._spent or beyond:
            passed = min(passed, _LONGEST) if passed > 0.0 else 0.0
            self._spent = max(0.0, self._spent * (1.0 - passed / _FORGET) + (passed if beyond else 0.0))
        return self._spent > _SLIGHTLY_FOR


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
