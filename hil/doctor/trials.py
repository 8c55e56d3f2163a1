"""The trials of commissioning, each under a tenth of the torque limit. There are three: the drive gets no commands, the
guardian acts, and this process gets two signals to stop.

Each trial is a run of the recorder with its guard and its guardian, so that the run ends with a torque-off in any case.
In the middle of the run the trial withholds the commands to the drive and reads the drive.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.gate import FallsSilent
from drivers.servo import (
    BadReply,
    Command,
    DeviceFault,
    DriverError,
    Limits,
    NoReply,
    Quantity,
    Sample,
    Servo,
    ServoInfo,
    Status,
)
from drivers.torque_off import confirm_torque_off
from hil.acquisition.commissioning import SHARE
from hil.acquisition.excitation import Profile
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.phases import Phase, Phases
from hil.acquisition.recorder import Recorder
from hil.acquisition.sink import Memory
from hil.doctor.checks import CheckList, Verdict
from hil.doctor.release import Left, Load
from hil.errors import WrongUse
from hil.guardian.servo import GuardedServo, Watch
from hil.stand.file import Stand
from hil.stand.opening import open_servo
from hil.stand.servo import StandServo

LOAD = 0.1
"""The load of a trial, as a fraction of the torque limit or of the deflection limit."""
_WATCH = Watch(silence=0.25, longest=10.0)
_RATE = 100.0  # Hz
_RISE, _HOLD = 0.5, 0.3  # s of the load's rise, and under it before the trial: a torque that stays longer looks stuck
_LOADED = 15  # samples before the trial that show the load
_BEYOND, _LONGEST, _UNKNOWN = 0.1, 1.0, 0.5  # s: silence beyond twice the watchdog, at most, without a known one
_TRIES = 10  # readings until one arrives, between the packets of the guardian
_ACTS, _ACTS_SURELY, _LATEST = 0.05, 0.1, 0.3  # s until the guardian's effect is read, and at most
_COUNTS = 2.0  # of torque that a load has at least
_SIGNALS = 2  # that this process sends itself
_SETTLES = 0.1  # s after torque-off until it is read


@dataclass(frozen=True, slots=True)
class Trial:
    """The result of one trial. left: the remaining load after `seconds` s."""

    left: Left
    seconds: float


Try = Callable[[Servo, Load], Trial | None]
"""A function that withholds the commands of the loaded servo and returns the trial. If it returns None, the run
continues, and the torque-off at the end of the run is the trial.
"""


class EndedEarly(Exception):
    """A run ended, with its torque off, before the trial was made; the message is the reason."""


class _TrialOver(Exception):
    """Raised inside a run to end it, because the trial has been made."""


class _TriedServo:
    """A servo for the recorder that makes `trial` in the middle of the run and passes everything else on to `servo`.

    torque_of: function that returns the magnitude of a sample's torque at the joint, N m. goal: the torque, N m, at
    which a commanded position is held.
    """

    def __init__(self, servo: Servo, trial: Try, torque_of: Callable[[Sample], float], goal: float) -> None:
        self.info, self.clock = servo.info, servo.clock
        self.close = servo.close
        self.load = Load([], [])
        self.made: Trial | None = None
        self.began = math.nan
        self._servo, self._trial, self._torque_of, self._goal = servo, trial, torque_of, goal
        self._rest: list[Sample] = []
        self._under: list[Sample] = []
        self._armed, self._sent = False, 0
        self._held: Command | None = None

    def arm(self, limits: Limits) -> None:
        """Arm the servo."""
        self._servo.arm(limits)
        self._armed = True

    def disarm(self) -> None:
        """Switch the servo's torque off."""
        self._armed, self._held = False, None
        self._servo.disarm()

    def exchange(self, command: Command) -> Sample:
        """Send a command to the servo and return its sample. Raises DriverError, and _TrialOver after the trial."""
        sample = self._servo.exchange(self._held or command)
        if not self._armed:
            self._rest.append(sample)
            return sample
        self._under = [*self._under[1 - _LOADED :], sample]
        if command.quantity is Quantity.POSITION and self._held is None and self._torque_of(sample) >= self._goal:
            self._held = command
        self._sent += 1
        if self._sent == round((_RISE + _HOLD) * _RATE):
            self._try()
        return sample

    def _try(self) -> None:
        self.load = Load(self._rest, self._under, measures=self.info.measures_when_off)
        self.began = self.clock.now()
        self.made = self._trial(self._servo, self.load)
        if self.made is not None:
            raise _TrialOver


def silence(info: ServoInfo) -> float:
    """Return the time without commands, s, for which a drive is tested. Raises WrongUse for a slow watchdog."""
    if not info.watchdog:
        return _UNKNOWN
    if info.watchdog > _LONGEST - _BEYOND:
        raise WrongUse(
            f"{info.backend}.watchdog = {info.watchdog:g} s is too long to be tried under torque: set it to 0.1"
        )
    return min(_LONGEST, 2.0 * info.watchdog + _BEYOND)


def read(servo: Servo) -> Sample:
    """Ask the servo for readings, without a set-point, and return the first that arrives. Raises DriverError."""
    for _ in range(_TRIES - 1):
        try:
            sample = servo.exchange(Command.rest())
        except (NoReply, BadReply):
            servo.clock.sleep_until(servo.clock.now() + 2e-3)
            continue
        if not sample.status & Status.STALE:
            return sample
    return servo.exchange(Command.rest())


def try_silence(servo: Servo, load: Load) -> Trial:
    """Send nothing for longer than the time of the drive's watchdog, then read the drive once: reading might change its
    state.
    """
    seconds = silence(servo.info)
    own = inner(servo)
    if not isinstance(own, FallsSilent):
        raise DriverError(f"the adapter of {servo.info.backend} cannot stop sending commands to its drive under torque")
    own.fall_silent()
    servo.clock.sleep_until(servo.clock.now() + seconds)
    try:
        return Trial(load.left([read(servo)]), seconds)
    except DeviceFault as error:
        return Trial(Left(None, math.nan, f"it does not say, since it reports: {error}"), seconds)


def try_guardian(servo: Servo, load: Load) -> Trial:
    """Let the guardian switch the torque off, and read the drive without sending commands."""
    own = inner(servo)
    if not isinstance(own, GuardedServo):
        raise DriverError("this servo has no guardian")
    once = not servo.info.watchdog  # of some of these the reading itself switches the torque off
    own.let_guardian_act()
    clock = servo.clock
    begun = clock.now()
    clock.sleep_until(begun + (_ACTS_SURELY if once else _ACTS))
    while True:
        left = load.left([read(servo)])
        passed = clock.now() - begun
        if left.releases or once or passed > _LATEST:
            return Trial(left, passed)
        clock.sleep_until(clock.now() + 0.01)


def try_second_signal(servo: Servo, load: Load) -> None:
    """Send two stop signals to this process, as pressing Ctrl-C twice does."""
    del servo, load
    for _ in range(_SIGNALS):
        signal.raise_signal(signal.SIGINT)


def inner(servo: Servo) -> Servo:
    """Return the servo of the drive itself, without the layer that adds the joint's sensor."""
    return servo.inner if isinstance(servo, StandServo) else servo


def make_trial(checks: CheckList, stand: Stand, mode: Quantity, name: str, trial: Try) -> Trial | None:
    """Open the servo, make one trial and close the servo. Return None if no trial was made or a signal arrived:
    `checks` says why.

    Raises EndedEarly, WrongUse, DriverError. The torque is off on return; otherwise `checks` contains an alarm.
    """
    servo, _ = open_servo(stand, quantity=mode, watch=_WATCH)
    try:
        silence(servo.info)
        checks.info = servo.info
        if trial is try_guardian and not isinstance(inner(servo), GuardedServo):
            checks.add(name, Verdict.SKIPPED, "this link has no guardian: see docs/reliability.md")
            return None
        return _made(checks, stand, mode, (servo, trial))
    finally:
        try:
            confirm_torque_off(servo, alarm=checks.alarm)
        finally:
            servo.close()


def _made(checks: CheckList, stand: Stand, mode: Quantity, what: tuple[Servo, Try]) -> Trial | None:
    limits, share = stand.checked_limits(), LOAD / SHARE
    goal = share * limits.torque
    ratio, from_cell = stand.stand.gear_ratio, stand.stand.torque_source == "joint"
    _check_counts(what[0].info, mode, goal / ratio)
    tried = _TriedServo(
        *what, lambda sample: abs(sample.joint_torque if from_cell else ratio * sample.motor_torque), goal
    )
    profile = _profile(mode, goal if mode is Quantity.TORQUE else LOAD * limits.deflection)
    with StopRequest().listening(goes_on=True) as stop:
        outcome = Recorder(stand, tried, profile, _RATE, Memory(), alarm=checks.alarm).run(stop)
        made = tried.made
        if not outcome.alarm and math.isfinite(tried.began):
            made = _after_off(checks, tried, made, outcome.phases)
    if stop.count > (_SIGNALS if what[1] is try_second_signal and math.isfinite(tried.began) else 0):
        checks.signal = stop.number
        return None
    if made is None and outcome.error is not None:
        raise EndedEarly(str(outcome.error))
    return made


def _check_counts(info: ServoInfo, mode: Quantity, load: float) -> None:
    """Raise WrongUse if a load of `load` N m is too small for the resolution of the drive."""
    if mode is Quantity.TORQUE and load < _COUNTS * info.torque_lsb:
        raise WrongUse(
            f"{LOAD * 100:.0f} % of the torque limit is {load:.2g} N m at the motor, below {_COUNTS:g} counts of this "
            f"drive ({info.torque_lsb:.2g} N m each), so that it cannot be commissioned: raise limits.torque, or use a "
            "smaller motor"
        )


def _after_off(checks: CheckList, tried: _TriedServo, made: Trial | None, phases: Phases) -> Trial | None:
    """Read the drive after its confirmed torque-off. Return `made`, the trial that was made; if that is None, return
    the trial of this torque-off. phases: the phases of the run.
    """
    off_at = next(t for t, phase in phases.history if phase is Phase.OFF)
    tried.clock.sleep_until(tried.clock.now() + _SETTLES)
    left = tried.load.left([read(tried)])
    if left.measured and not left.releases:
        checks.alarm(f"CUT THE POWER: the drive confirmed torque-off and still makes {left.words}")
    return Trial(left, off_at - tried.began) if made is None else made


def _profile(mode: Quantity, size: float) -> Profile:
    """Return a profile that rises to `size`, N m or rad at the joint, and stays there."""
    duration = 2.0 * (_RISE + _HOLD)
    return Profile("file", mode, size, duration, (0.1, 1.0), _RISE, 0, "", np.ones_like)
