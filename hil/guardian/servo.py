"""A servo with a guardian: it gives a sign of life whenever the recorder waits or sends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from drivers.clock import MonotonicClock
from drivers.gate import FallsSilent
from drivers.off_path import HasJournal, HasOffPath
from drivers.servo import Command, DriverError, Limits, Sample, Servo
from hil.guardian.handle import Guardian, available

_SLICE = 5e-3  # s between two signs of life in a long wait
_ARMING = 30.0  # s that arming may take; no set-point has been sent yet
_REMEMBERED = 15  # round trips at rest
_SLOWEST = 0.1  # s that a round trip of a slow line may usually take
_SWITCHING_OFF = 1.5  # s until the guardian sends torque-off too
_OTHER_WAY = 0.3  # s for it to do so
_LONGEST_SILENCE = 1.3  # s without a sign of life while a watchdog is tried


@dataclass(frozen=True, slots=True)
class Watch:
    """When the guardian switches the torque off.

    silence: time without a sign of life, s. longest: time from arming until the torque must be off, s.
    """

    silence: float = 0.045
    longest: float = math.inf


class GuardedClock(MonotonicClock):
    """A monotonic clock that gives signs of life while it waits, by calling `beat`."""

    def __init__(self, beat: Callable[[], None]) -> None:
        self._beat = beat

    def sleep_until(self, t: float) -> None:
        """Wait until `t` s; return at once if `t` has passed. Raises GuardianFired, GuardianLost."""
        while self.now() + _SLICE < t:
            self._beat()
            time.sleep(_SLICE)
        self._beat()
        super().sleep_until(t)
        self._beat()


class GuardedServo:
    """The servo `servo` with a guardian, which switches the torque off if this process cannot.

    inner: the servo without its guardian. clock: gives signs of life while it waits.

    The guardian runs from arming until `close`. If opening the servo has changed a setting of the drive, the guardian
    runs from the opening on, so that the setting is restored even if this process is killed before arming. After the
    guardian has acted, `exchange` sends nothing, and only the torque-off is sent. Raises DriverError if the guardian
    cannot be started.
    """

    def __init__(self, servo: Servo, path: HasOffPath, watch: Watch) -> None:
        self.info, self.inner = servo.info, servo
        self._servo = servo
        self._path = path
        self._watch = watch
        self._guardian = self._started() if path.off_path().restore else None
        self._beating = False
        self._took: list[float] = []
        self._usual = 0.0
        self._off_since = math.nan
        self.clock = GuardedClock(self.beat)

    def _started(self) -> Guardian:
        return Guardian(self._path.off_path(), self._watch.silence)

    def beat(self) -> None:
        """Give a sign of life if the servo is armed. Raises GuardianFired, GuardianLost."""
        if self._beating and self._guardian is not None:
            self._guardian.check()
            self._guardian.beat()

    def arm(self, limits: Limits) -> None:
        """Start the guardian, then arm the servo. Raises DriverError, also if the guardian cannot be started."""
        if self._guardian is None:
            self._guardian = self._started()
        guardian = self._guardian
        guardian.check()
        self._usual = min(median(self._took), _SLOWEST) if self._took else 0.0
        self._off_since = math.nan
        guardian.expect(_ARMING)
        guardian.limit(self._watch.longest)
        if isinstance(self._servo, HasJournal):  # whoever is killed while it arms has said what is to be restored
            self._servo.keep_journal(lambda: guardian.restore(self._path.off_path()))
        try:
            self._servo.arm(limits)
        finally:
            guardian.restore(self._path.off_path())
        self._beating = True
        guardian.beat()

    def exchange(self, command: Command) -> Sample:
        """Send a command and return the servo's sample. Raises DriverError, or GuardianFired or GuardianLost before
        anything is sent.
        """
        if self._beating and self._guardian is not None:
            self._guardian.check()
            self._guardian.beat(self._usual)
            return self._servo.exchange(command)
        before = self.clock.now()
        sample = self._servo.exchange(command)
        self._took = [*self._took[-_REMEMBERED:], self.clock.now() - before]
        return sample

    def fall_silent(self) -> None:
        """Send neither set-points nor signs of life any more. The guardian acts after `_LONGEST_SILENCE` s at the
        latest.

        Raises DriverError if the servo cannot stop its own messages.
        """
        if not isinstance(self._servo, FallsSilent):
            raise DriverError(f"{self.info.backend}: this adapter cannot stop sending commands while the torque is on")
        self._beating = False
        if self._guardian is not None:
            self._guardian.expect(_LONGEST_SILENCE)
        self._servo.fall_silent()

    def let_guardian_act(self) -> None:
        """Send nothing more, and let the guardian switch the torque off. Raises DriverError if the guardian is not
        running.
        """
        if self._guardian is None:
            raise DriverError("the servo was not armed, so that it has no guardian yet")
        self._guardian.check()
        self.fall_silent()
        self._guardian.fire(tried=True)

    def disarm(self) -> None:
        """Switch the torque off. If the guardian has already acted, end it first: two senders on one line corrupt each
        other's frames.
        """
        guardian = self._guardian
        if guardian is None:
            self._servo.disarm()
            return
        self._beating = False
        if guardian.fired:
            guardian.stand_down()
        if math.isnan(self._off_since):
            self._off_since = self.clock.now()
            guardian.expect(_SWITCHING_OFF)
        self._servo.disarm()
        self._off_since = -math.inf
        guardian.expect(math.inf)

    def close(self) -> None:
        """Switch the torque off, restore settings and close the link; then end the guardian. Never raises."""
        guardian, self._guardian = self._guardian, None
        self._beating = False
        if guardian is None:
            self._servo.close()
            return
        try:
            if math.isfinite(self._off_since):  # the torque-off was not confirmed
                guardian.fire()
                self.clock.sleep_until(self.clock.now() + _OTHER_WAY)
                guardian.stand_down()
            self._servo.close()
        finally:
            guardian.close()


def guarded(servo: Servo, watch: Watch) -> Servo:
    """Return `servo` with a guardian. It is returned unchanged if its clock is virtual, if no other process can reach
    its drive, or on Windows.

    Raises DriverError if the guardian cannot be started; the servo is then closed.
    """
    if not (isinstance(servo, HasOffPath) and isinstance(servo.clock, MonotonicClock) and available()):
        return servo
    try:
        return GuardedServo(servo, servo, watch) if servo.off_path().reachable else servo
    except BaseException:
        servo.close()
        raise
