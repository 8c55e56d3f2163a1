"""The phases of a run under random faults at random ticks, run after run on one servo."""

from __future__ import annotations

import math
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from drivers.servo import BadReply, Command, DeviceFault, Limits, LinkLost, NoReply, Quantity, Sample, Status
from hil.acquisition import excitation
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.phases import FOLLOWS, Outcome, Phase, Phases
from hil.acquisition.recorder import Recorder
from hil.acquisition.sink import Memory
from hil.recording.channels import Row
from hil.stand.file import parse

from ..conftest import SpringServo

RATE, DURATION, FADE = 200.0, 0.5, 0.1
TICKS = round(RATE * DURATION) + 1
STAND = parse(
    '[stand]\ngear_ratio = 4.0\ntorque_source = "joint"\n[limits]\ntorque = 0.1\ndeflection = 0.06\nvelocity = 50.0\n'
)
PROFILE = excitation.make(
    "sine",
    Quantity.TORQUE,
    amplitude=0.05,
    default_amplitude=1.0,
    duration=DURATION,
    band=(4.0, 4.0),
    rate=RATE,
    fade=FADE,
)
ticks = st.integers(0, TICKS)
ERRORS = (
    NoReply("-"),
    BadReply("-"),
    LinkLost("-"),
    DeviceFault(1, "-"),
    OSError(5, "-"),
    ZeroDivisionError("-"),
    KeyboardInterrupt(),
)


class FullDisk(Memory):
    """A sink that fails at row `at`."""

    def __init__(self, at: int) -> None:
        super().__init__()
        self._at = at

    def append(self, row: Row) -> None:
        if len(self) == self._at:
            raise OSError(28, "No space left on device")
        super().append(row)


class FaultyServo(SpringServo):
    """A spring servo whose computer stalls, or is asked to stop, before some of the set-points."""

    stalls: dict[int, float]
    stops: set[int]
    stop: StopRequest
    arm_error: Exception | None = None

    def arm(self, limits: Limits) -> None:
        super().arm(limits)
        if self.arm_error is not None:
            raise self.arm_error

    def exchange(self, command: Command) -> Sample:
        tick = len(self.driven)
        if self.armed:
            self.clock.t += self.stalls.get(tick, 0.0)
            if tick in self.stops:
                self.stop.count += 1
                self.stop.number = 2
            planned: object = self.script.get(tick)
            if isinstance(planned, KeyboardInterrupt):
                self.driven.append(command)
                raise planned
        return super().exchange(command)


class Runs(RuleBasedStateMachine):
    """Faults are planned, then a run takes place, again and again on the same servo."""

    @initialize()
    def begin(self) -> None:
        self.servo = FaultyServo()
        self.folder = Path(tempfile.gettempdir())
        self.forget()

    def forget(self) -> None:
        servo = self.servo
        servo.script, servo.stalls, servo.stops, servo.stop = {}, {}, set(), StopRequest()
        servo.arm_error = servo.disarm_error = None
        servo.disarms = servo.heard_after = 0
        servo.driven.clear()
        self.full = TICKS + 1

    @rule(tick=ticks, error=st.sampled_from(ERRORS), count=st.integers(1, 6))
    def reply_fails(self, tick: int, error: Exception, count: int) -> None:
        self.servo.script.update(dict.fromkeys(range(tick, tick + count), error))

    @rule(
        tick=ticks,
        name=st.sampled_from(["joint_torque", "motor_position", "motor_velocity", "temperature", "status"]),
        value=st.sampled_from([math.nan, math.inf, -1e9, 0.0, 68.0, float(int(Status.STALE))]),
        count=st.integers(1, 30),
    )
    def reading_is_wrong(self, tick: int, name: str, value: float, count: int) -> None:
        if name == "status" and not math.isfinite(value):
            value = 0.0
        wrong = {name: abs(value) % 32.0 if name == "status" else value}
        self.servo.script.update(dict.fromkeys(range(tick, tick + count), wrong))

    @rule(tick=ticks, seconds=st.sampled_from([3e-3, 6e-3, 12e-3, 30e-3, 49e-3, 80e-3, 3600.0]))
    def computer_stalls(self, tick: int, seconds: float) -> None:
        self.servo.stalls[tick] = seconds

    @rule(tick=ticks)
    def stop_is_requested(self, tick: int) -> None:
        self.servo.stops.add(tick)

    @rule(row=ticks)
    def disk_is_full(self, row: int) -> None:
        self.full = row

    @rule(error=st.sampled_from(ERRORS[:5]))
    def arming_fails(self, error: Exception) -> None:
        self.servo.arm_error = error

    @rule(error=st.sampled_from(ERRORS), heard_after=st.integers(0, 19))
    def torque_off_fails(self, error: BaseException, heard_after: int) -> None:
        self.servo.disarm_error, self.servo.heard_after = error, heard_after

    @rule()
    def run(self) -> None:
        servo, rows = self.servo, FullDisk(self.full)
        outcome = Recorder(STAND, servo, PROFILE, RATE, rows, scratch=self.folder).run(servo.stop)
        self.check_torque(servo, rows)
        confirmed = servo.disarm_error is None or servo.heard_after > 0
        assert servo.armed == (not confirmed)
        assert bool(outcome.alarm) == (not confirmed)
        self.check_phases(outcome, confirmed=confirmed)
        assert not isinstance(outcome.error, ValueError) or isinstance(outcome.error, BadReply)  # of the state machine
        servo.disarm_error = None
        servo.disarm()
        self.forget()

    def check_torque(self, servo: FaultyServo, rows: Memory) -> None:
        """No set-point exceeds the profile's, and each but the last has its row."""
        sent = np.array([command.value for command in servo.driven])
        assert np.isfinite(sent).all()
        assert (np.abs(sent) <= 0.05 / 4.0 + 1e-12).all()
        status = rows.channel("status").astype(int) if len(rows) else np.zeros(0, dtype=int)
        answered = np.count_nonzero(status & int(Status.MISSED) == 0)
        assert len(servo.driven) - answered in {0, 1}
        if len(rows):
            assert rows.channel("seq").tolist() == list(range(len(rows)))
            wanted = PROFILE.at(np.arange(len(rows)) / RATE)
            kept = (np.abs(wanted) > 1e-6) & (status & int(Status.MISSED) == 0)
            share = rows.channel("command")[kept] / wanted[kept]
            assert (np.diff(share) <= 1e-9).all()  # what has begun to ramp down never rises again
            assert ((share >= 0.0) & (share <= 1.0 + 1e-9)).all()

    def check_phases(self, outcome: Outcome, *, confirmed: bool) -> None:
        names = [phase for _, phase in outcome.phases.history]
        assert all(after in FOLLOWS[before] for before, after in pairwise([Phase.REST, *names]))
        assert (outcome.phases.now is Phase.OFF) == confirmed
        times = [t for t, _ in outcome.phases.history]
        assert times == sorted(times)
        if outcome.end_reason == "done":
            assert names == [Phase.ARMING, Phase.FADE_IN, Phase.RUN, Phase.OFF]


TestRuns = Runs.TestCase
TestRuns.settings = settings(max_examples=25, stateful_step_count=12, suppress_health_check=list(HealthCheck))


def test_a_phase_that_cannot_follow_is_refused() -> None:
    for before, after in [(a, b) for a in Phase for b in Phase if b not in FOLLOWS[a]]:
        phases = Phases()
        phases.now = before
        with pytest.raises(ValueError, match=f"from {before} to {after}"):
            phases.enter(after, 0.0)
        assert phases.now is before
