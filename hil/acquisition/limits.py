"""The limits of a run: each has a name, gives its reason, and says how long it must be exceeded.

All are at the joint in SI and come from the stand's limits. A single reading far beyond a limit ends a run. A reading
slightly beyond it must repeat within a few readings, so that one wrong count does not end a recording. Values that are
not finite are handled before any comparison, since no comparison finds NaN above a limit.
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
    """One reply converted to the joint: N m, rad, rad/s; NaN if there is no such reading."""

    torque: float = math.nan
    dtheta: float = math.nan
    dtheta_dot: float = math.nan


class Limit(Protocol):
    """One limit. name: of the quantity, for messages."""

    name: str

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Take the readings at rest. Raises LimitReached if the run must not begin."""

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check one reply. Raises LimitReached, and BadReply if a sensor is no longer reliable."""


class Persistence:
    """Whether a condition held in at least `_TIMES` of the last `_OF` readings.

    seen: in how many of them it held. While it is 0, a reading in which the condition does not hold changes nothing and
    may be skipped.
    """

    __slots__ = ("seen",)

    def __init__(self) -> None:
        self.seen = 0

    def __call__(self, now: bool) -> bool:
        """Take a reading; return whether the condition holds for the `_TIMES`-th time."""
        self.seen = (self.seen << 1 | now) & ((1 << _OF) - 1)
        return now and self.seen.bit_count() >= _TIMES


class Presence:
    """A reading that existed at rest must continue to come: without it the run would have no such limit."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._missing = Persistence()
        self.expected = False

    @property
    def settled(self) -> bool:
        """Return whether no reading was missing recently."""
        return not self._missing.seen

    def check(self, value: float) -> bool:
        """Return whether there is a reading. Raises BadReply if it is missing for the third time."""
        present = math.isfinite(value)
        if (self._missing.seen or not present) and self._missing(not present) and self.expected:
            raise BadReply(f"the {self._name} was missing from {_TIMES} replies: check its sensor and cable")
        return present


class Level:
    """The magnitude of one field of `AtJoint`: torque, deflection or velocity."""

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
        """See `Limit`."""
        del samples
        self._present.expected = any(math.isfinite(one[self._field]) for one in at_joint)

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """See `Limit`."""
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
    """The check of the winding's temperature, degC, which must stay below its limit and change while the motor is
    loaded.

    The temperature may be constant in thermal equilibrium. On the way there, a reading in steps slows down: its last
    step takes at least ln 2 of the time constant, which is minutes for the case of a motor. A reading that changed
    faster and then stays constant is frozen.
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
        """See `Limit`."""
        del at_joint
        temperatures = [sample.temperature for sample in samples if math.isfinite(sample.temperature)]
        self._present.expected = bool(temperatures)
        if temperatures and temperatures[-1] > self._limit - _COOL_START:
            raise LimitReached(
                f"the winding is at {temperatures[-1]:.0f} degC, within {_COOL_START:.0f} of its limit of "
                f"{self._limit:.0f}: let it cool down first"
            )

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """See `Limit`."""
        value = sample.temperature
        if value == self._same and -self._loaded <= at_joint.torque <= self._loaded and self._present.settled:
            self._last = sample.t  # it was below its limit, and need not change while the motor is idle
            return
        if not self._present.check(value):
            return
        if value > self._limit - _COOL_RUN:
            raise LimitReached(f"the winding reached {value:.0f} degC; its limit is {self._limit:.0f}")
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
    """The check that the drive's supply voltage stays close to its value at rest."""

    name = "voltage"

    def __init__(self) -> None:
        self._at_rest = math.nan
        self._away = Persistence()

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """See `Limit`."""
        del at_joint
        self._at_rest = next((one.voltage for one in reversed(samples) if math.isfinite(one.voltage)), math.nan)

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """See `Limit`."""
        del at_joint
        away = abs(sample.voltage - self._at_rest) > _SUPPLY * self._at_rest  # false where one is NaN
        if (away or self._away.seen) and self._away(away):
            raise LimitReached(
                f"the supply voltage went from {self._at_rest:.3g} V at rest to {sample.voltage:.3g} V: the torque is "
                "not what was commanded; use a supply with more current, or with a brake resistor"
            )


class Lock:
    """The check that the locked joint does not turn, if its angle is measured. limit: the largest allowed deflection,
    rad.
    """

    name = "lock"

    def __init__(self, limit: float) -> None:
        self._most = _YIELDS * limit
        self._at_rest = math.nan
        self._turned = Persistence()

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """See `Limit`."""
        del at_joint
        angles = [one.joint_position for one in samples if math.isfinite(one.joint_position)]
        self._at_rest = angles[-1] if angles else math.nan

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """See `Limit`."""
        del at_joint
        turned = abs(sample.joint_position - self._at_rest)
        moved = turned > self._most  # false where one is NaN
        if (moved or self._turned.seen) and self._turned(moved):
            raise LimitReached(
                f"the joint turned by {turned:.2g} rad: it is not locked, so Kc would be too small; lock it"
            )
