"""Let every fault happen in every phase of a run, on every adapter, in virtual time: python benchmarks/faults.py

Prints for each fault and phase the longest time, over the adapters, from the fault to the last moment with torque, and
on how many the run goes on and ends with its torque off; --write puts the table into results/faults.csv. A motor that
is left on must at least raise the alarm ("CUT THE POWER"); ends with status 1 where one is left on without it. The
faults are those of `hil record --faults` and `hil emulate --faults`. A killed process sends nothing more; 5 ms later
the guardian's packets arrive, as its process sends them. A run whose drive ignores torque-off is ended by two signals,
since the profile's own end leaves no torque on. Of a disk that does not answer the memory between the recorder and the
writing process holds 0.1 s of rows here, and not 8 s: the run ends when it is half full.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, cast
from unittest.mock import MagicMock, patch

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from drivers.clock import Clock, VirtualClock  # noqa: E402 - the rigs are those of the tests
from drivers.servo import Command, Limits, Quantity, Sample, Servo  # noqa: E402
from hil.acquisition import excitation  # noqa: E402
from hil.acquisition.interrupt import StopRequest  # noqa: E402
from hil.acquisition.phases import Outcome, Phase  # noqa: E402
from hil.acquisition.recorder import Recorder  # noqa: E402
from hil.acquisition.sink import Memory, Sink  # noqa: E402
from hil.errors import Untrustworthy  # noqa: E402
from hil.recording import background  # noqa: E402
from hil.recording.background import BackgroundWriter  # noqa: E402
from hil.recording.channels import Row  # noqa: E402
from hil.recording.writer import Header, RecordingWriter  # noqa: E402
from hil.recording.writer_process import drain  # noqa: E402
from hil.stand.file import parse  # noqa: E402
from sim_backend.fault_plan import DRIVE, HOST, LINK, FaultPlan, PlannedFault  # noqa: E402
from sim_backend.faulty_servo import FaultyServo  # noqa: E402
from sim_backend.parameters import SimParameters  # noqa: E402
from sim_backend.servo import SimServo  # noqa: E402
from sim_backend.wire.faults import follow  # noqa: E402
from tests.drivers import conftest as rigs  # noqa: E402

RATE = 400.0
RAMP_AT = 100  # tick at which the run with a ramp-down is stopped
LASTS = 0.4  # s of a fault of the link that would be over at once
AFTER = 0.5  # s after the run in which a watchdog may act
LOOKS, SENDS = 5e-3, 40  # s until the guardian sends, and how often
PHASES = (Phase.REST, Phase.ARMING, Phase.FADE_IN, Phase.RUN, Phase.RAMP_DOWN)
HELD = 0.1  # s of rows between the recorder and the writing process
KINDS = [*LINK, *DRIVE, *HOST]
SIZES = {"ignored-off": 0.5}  # share of the torque limit, where 0.05 is none
STAND = """
[stand]
torque_stays_on_if_host_dies = true
[limits]
torque = {torque}
deflection = 1.5
velocity = {velocity}
temperature = {temperature}
"""


class Cell(NamedTuple):
    """The outcome of one run: s from the fault to the end of the torque, whether it stayed on, whether the alarm was
    raised, and whether the fault ended the run.
    """

    off: float
    on: bool
    alarm: bool
    ended: bool


@dataclass
class Stand:
    """An adapter on its emulated drive. on: whether it makes torque; wait: let s pass; changes: (s, on) so far. guard:
    sends what the guardian would send.
    """

    servo: Servo
    limits: Limits
    on: Callable[[], bool]
    wait: Callable[[float], None]
    guard: Callable[[], object] = lambda: None
    changes: list[tuple[float, bool]] = field(default_factory=list)


def on_the_wire(rig: Any, limits: Limits, can: bool, plan: FaultPlan) -> Stand:
    """Return an adapter over its emulator."""
    follow(plan, rig.faults, [rig.motor], 0.0, can=can)
    motor = rig.motor
    wired = rigs.wired_rig(rig, limits)
    servo: Any = wired.servo
    stand = Stand(servo, limits, lambda: bool(motor.commanded), rig.wait)
    stand.guard = lambda: [wired.put(packet) for packet in (servo.off_path().resync, *servo.off_path().off) if packet]
    motor.observer = lambda: stand.changes.append((motor.time, stand.on()))
    return stand


def simulated(plan: FaultPlan) -> Stand:
    """Return the simulated servo."""
    clock = VirtualClock()
    inner = SimServo(SimParameters(), seed=0, clock=clock, watched="broken-watchdog" not in plan.kinds())
    servo = FaultyServo(cast("Servo", inner), plan, lambda _: None)
    stand = Stand(servo, rigs.SIM_LIMITS, lambda: inner.true_state().enabled, lambda _: None)

    def wait(seconds: float) -> None:
        clock.sleep_until(clock.now() + seconds)
        stand.changes.append((clock.now(), inner.true_state().enabled))

    stand.wait = wait
    return stand


def wired(make: Callable[[], Any], limits: Limits, *, can: bool) -> Callable[[FaultPlan], Stand]:
    """Return the maker of an adapter over its emulator."""
    return lambda plan: on_the_wire(make(), limits, can, plan)


ADAPTERS: Mapping[str, Callable[[FaultPlan], Stand]] = {
    "sim": simulated,
    "dynamixel": wired(rigs.new_rig, rigs.SERVO_LIMITS, can=False),
    "feetech": wired(rigs.feetech_rig, rigs.FEETECH_LIMITS, can=False),
    "commander": wired(rigs.new_foc, rigs.SIM_LIMITS, can=False),
    "odrive": wired(rigs.odrive_rig, rigs.ODRIVE_LIMITS, can=True),
    "mit": wired(rigs.mit_rig, rigs.MIT_LIMITS, can=True),
    "robstride": wired(rigs.robstride_rig, rigs.MIT_LIMITS, can=True),
    "moteus": wired(rigs.moteus_rig, rigs.MIT_LIMITS, can=True),
    "cia402": wired(rigs.cia402_rig, rigs.CIA402_LIMITS, can=True),
}


class Killed(BaseException):
    """This process is no more."""


class Watched:
    """A servo whose ticks are noted, and which is stopped at one of them, by so many signals. killed: s at which the
    process is gone.
    """

    def __init__(self, stand: Stand, stop: StopRequest, at: float, signals: int, killed: float) -> None:
        self.info, self.clock = stand.servo.info, stand.servo.clock
        self._stand, self._stop, self._at, self._ticks = stand, stop, at, 0
        self._signals, self._killed, self._gone = signals, killed, False

    def arm(self, limits: Limits) -> None:
        """Arm it; a process that is to be killed meanwhile is killed behind it."""
        self._live()
        self._stand.servo.arm(limits)
        self._live()

    def disarm(self) -> None:
        """Switch it off, unless the process is gone."""
        self._live()
        self._stand.servo.disarm()

    def _live(self) -> None:
        if self.clock.now() < self._killed:
            return
        for _ in range(0 if self._gone else SENDS):
            self._stand.wait(LOOKS)
            self._stand.guard()
        self._gone = True
        raise Killed

    def exchange(self, command: Command) -> Sample:
        """Note the state of the drive before and after an exchange."""
        self._live()
        self._ticks += 1
        if self._ticks >= self._at:
            self._stop.count, self._stop.number = max(self._stop.count, self._signals), 2
        try:
            return self._stand.servo.exchange(command)
        finally:
            self._stand.changes.append((self.clock.now(), self._stand.on()))


class FullDisk(Memory):
    """Memory that takes no more rows from a time on."""

    def __init__(self, clock: Clock, full: float) -> None:
        super().__init__()
        self._clock, self._full = clock, full

    def append(self, row: Row) -> None:
        """Add one row. Raises Untrustworthy where there is no room."""
        if self._clock.now() >= self._full:
            raise Untrustworthy("the disk is full")
        super().append(row)


class FrozenDisk(BackgroundWriter):
    """A recording whose rows are written at once, and not at all from a time on until the run has ended."""

    def __init__(self, folder: Path, clock: Clock, frozen: float) -> None:
        self._clock, self._frozen = clock, frozen
        with patch.object(background, "_HELD", HELD), patch.object(background, "_FEWEST", 1):
            super().__init__(RecordingWriter(folder / "run.h5", Header(profile={"kind": "sine"}), 1000), RATE)

    def _start(self, file: int) -> Any:
        self._disk = file
        process = MagicMock()  # its work is done by `append`
        process.poll = lambda: 0 if process.stdin.close.called else None
        return process

    def append(self, row: Row) -> None:
        """Add one row. Raises Untrustworthy once the memory is half full."""
        super().append(row)
        if self._clock.now() < self._frozen:
            drain(self._ring, self._disk)


def sink_of(kind: str, at: float, clock: Clock, folder: Path, stack: ExitStack) -> Sink:
    """Return what takes the rows. kind, at: a fault of the computer and its time, s. stack: discards them."""
    if kind != "disk-frozen":
        return FullDisk(clock, at if kind == "disk-full" else math.inf)
    writer = FrozenDisk(folder, clock, at)
    stack.callback(writer.discard)
    return writer


def driven(stand: Stand, *, stopped: bool, kind: str = "", at: float = math.inf) -> Outcome:
    """Run a sine on it; return how that went. The torque is off afterwards where anything can switch it off.

    kind, at: a fault of the computer, or one that needs another end of the run, and its time, s.
    """
    limits = stand.limits
    file = parse(STAND.format(torque=limits.torque, velocity=limits.velocity, temperature=limits.temperature))
    quantity = Quantity.TORQUE if Quantity.TORQUE in stand.servo.info.quantities else Quantity.POSITION
    size = SIZES.get(kind, 0.05) * limits.torque if quantity is Quantity.TORQUE else 0.05
    profile = excitation.make(
        "sine", quantity, amplitude=size, default_amplitude=size, duration=0.35, band=(4.0, 4.0), rate=RATE, fade=0.1
    )
    stop = StopRequest()
    signals, tick = (2, RAMP_AT) if kind == "ignored-off" else (1, RAMP_AT if stopped else math.inf)
    servo = Watched(stand, stop, tick, signals, at if kind == "kill" else math.inf)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        sink = sink_of(kind, at, stand.servo.clock, Path(folder), stack)
        outcome = Recorder(file, cast("Servo", servo), profile, RATE, sink, scratch=Path(folder)).run(stop)
    if not isinstance(outcome.error, Killed):
        stand.servo.close()
    for _ in range(round(AFTER / 0.005)):
        stand.wait(0.005)
    return outcome


def moments(make: Callable[[FaultPlan], Stand]) -> dict[Phase, float]:
    """Return a time, s, in the middle of each phase."""
    begins = {phase: t for t, phase in _history(make)}
    rest = begins[Phase.ARMING] - 0.5 * 15 / RATE
    ends = {Phase.ARMING: Phase.FADE_IN, Phase.FADE_IN: Phase.RUN, Phase.RUN: Phase.RAMP_DOWN}
    middle = {phase: 0.5 * (begins[phase] + begins[after]) for phase, after in ends.items()}
    return {Phase.REST: rest, **middle, Phase.RAMP_DOWN: begins[Phase.RAMP_DOWN] + 0.04}


def _history(make: Callable[[FaultPlan], Stand]) -> list[tuple[float, Phase]]:
    outcome = driven(make(FaultPlan()), stopped=True)
    if outcome.error is not None:
        raise outcome.error
    return outcome.phases.history


def judged(make: Callable[[FaultPlan], Stand], kind: str, at: float, phase: Phase) -> Cell | None:
    """Return the outcome of one fault, None where it cannot happen on this adapter."""
    lasts = LASTS if kind in LINK and not LINK[kind].lasting and kind != "reboot" else math.nan
    plan = FaultPlan([] if kind in HOST else [PlannedFault(kind, at=at, duration=lasts)])
    try:
        stand = make(plan)
    except ValueError:
        return None
    outcome = driven(stand, stopped=phase is Phase.RAMP_DOWN, kind=kind, at=at)
    lit = [t for t, on in stand.changes if on and t > at]
    on = stand.on()
    if isinstance(outcome.error, Killed):
        stand.servo.close()  # for the next one
    return Cell(max(lit, default=at) - at, on, bool(outcome.alarm), outcome.error is not None)


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--adapters", nargs="+", choices=ADAPTERS, default=list(ADAPTERS))
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--write", action="store_true", help="write results/faults.csv")
    options = parser.parse_args()
    times = {name: moments(ADAPTERS[name]) for name in options.adapters}
    lines = ["| fault | " + " | ".join(PHASES) + " |", "| --- |" + " --- |" * len(PHASES)]
    breaches, cases = 0, 0
    for kind in options.kinds:
        row = []
        for phase in PHASES:
            cells = {name: judged(ADAPTERS[name], kind, times[name][phase], phase) for name in options.adapters}
            happened = {name: cell for name, cell in cells.items() if cell is not None}
            cases += len(happened)
            breaches += sum(cell.on and not cell.alarm for cell in happened.values())
            row.append(summary(happened))
        lines.append(f"| {kind} | " + " | ".join(row) + " |")
        print(lines[-1], flush=True)
    text = f"{cases} runs on {', '.join(options.adapters)}; {breaches} left the torque on without the alarm.\n"
    print(text)
    if options.write:
        from page import machine, write_result  # here: tests import this script from another folder

        write_result("faults", "\n".join([f"{machine()}.", text, *lines]))
    return int(breaches > 0)


def summary(cells: Mapping[str, Cell]) -> str:
    """Return the words for one fault in one phase, over the adapters."""
    ended = [cell.off for cell in cells.values() if cell.ended and not cell.on]
    on = {name: cell.alarm for name, cell in cells.items() if cell.on}
    words = [f"{max(ended) * 1e3:.0f} ms"] if ended else []
    for word, alarm in (("alarm", True), ("ON", False)):
        names = ", ".join(name for name, alarmed in on.items() if alarmed == alarm)
        words += [f"{word}: {names}"] if names else []
    going = [name for name, cell in cells.items() if not cell.ended and not cell.on]
    if going:
        words.append("goes on" if len(going) == len(cells) else f"{len(going)} of {len(cells)} go on")
    return "; ".join(words)


if __name__ == "__main__":
    sys.exit(main())
