"""A sensor at the joint beside the servo: whose time its readings keep, and what its silence means."""

from __future__ import annotations

import hashlib
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest

from drivers.clock import Clock, VirtualClock
from drivers.servo import Command, DriverError, Limits, LinkLost, NoReply, Quantity
from hil.errors import Untrustworthy, WrongUse
from hil.recording.channels import CHANNELS
from hil.recording.reader import Array, Recording
from hil.recording.writer import Header, write
from hil.signals.prepare import prepare
from hil.stand.devices import Device
from hil.stand.file import parse
from hil.stand.opening import open_servo
from hil.stand.servo import SILENCE, StandServo
from sim_backend.parameters import SimParameters
from sim_backend.servo import SimServo

from ..conftest import Maker, edited

LIMITS = Limits(torque=4e-3, velocity=400.0, temperature=80.0, position=(-3.0, 3.0))


@dataclass
class Cell:
    """A torque cell that takes a reading every `period` s; from `silent` s on it takes none, or raises `error`."""

    clock: Clock
    period: float = 0.0125
    silent: float = math.inf
    error: DriverError | None = None
    closed: int = field(default=0)

    def read(self) -> tuple[float, float]:
        now = self.clock.now()
        if self.error is not None and now >= self.silent:
            raise self.error
        taken = math.floor(min(now, self.silent) / self.period) * self.period
        return taken, 0.25 + taken

    def close(self) -> None:
        self.closed += 1


def simulated() -> SimServo:
    return SimServo(SimParameters(), seed=1, clock=VirtualClock())


def ask(servo: StandServo, command: Command | None = None) -> tuple[float, float, float]:
    """Read time of the motor, of the joint, and the joint's torque; a reply the simulator lost is asked for again."""
    servo.clock.sleep_until(servo.clock.now() + 0.002)
    try:
        sample = servo.exchange(command or Command.rest())
    except NoReply as error:
        if "joint sensor" in str(error):
            raise
        return ask(servo, command)
    return sample.t_read, sample.t_joint, sample.joint_torque


def ask_until(servo: StandServo, t: float) -> tuple[float, float, float]:
    while servo.clock.now() < t:
        last = ask(servo)
    return last


def test_a_slow_sensors_reading_is_kept_with_the_time_it_was_taken() -> None:
    servo = simulated()
    stand = StandServo(servo, 0.0, Cell(servo.clock))
    rows = [ask(stand) for _ in range(100)]
    for t_read, t_joint, torque in rows:
        assert t_joint <= t_read + 0.002
        assert t_read - t_joint < 0.0125 + 0.002
        assert torque == 0.25 + t_joint
    assert len({t_joint for _, t_joint, _ in rows}) < len(rows) / 3


@pytest.mark.parametrize("error", [None, NoReply("nothing came")])
def test_a_lost_reading_is_a_gap_and_a_silent_sensor_ends_the_run(error: DriverError | None) -> None:
    servo = simulated()
    stand = StandServo(servo, 0.0, Cell(servo.clock, silent=0.1, error=error))
    last = ask_until(stand, 0.1 + 0.5 * SILENCE)
    assert math.isnan(last[2]) == (error is not None)
    with pytest.raises(NoReply, match="joint sensor has given no new reading"):
        ask_until(stand, 0.1 + 2.0 * SILENCE)


def test_a_sensor_that_is_gone_is_a_lost_link() -> None:
    servo = simulated()
    stand = StandServo(servo, 0.0, Cell(servo.clock, silent=0.0, error=LinkLost("gone")))
    with pytest.raises(LinkLost):
        ask(stand)


def test_the_stands_zero_is_taken_off_the_motor_both_ways() -> None:
    servo = simulated()
    stand = StandServo(servo, -0.5, None)
    stand.arm(Limits(torque=4e-3, velocity=400.0, temperature=80.0, position=(0.4, 0.6)))
    for _ in range(400):
        stand.clock.sleep_until(stand.clock.now() + 0.002)
        try:
            sample = stand.exchange(Command(Quantity.POSITION, 0.55))
        except NoReply:
            continue
    assert sample.motor_position == pytest.approx(0.55, abs=0.01)


def test_closing_turns_the_torque_off_and_closes_both_links() -> None:
    servo = simulated()
    cell = Cell(servo.clock)
    stand = StandServo(servo, 0.0, cell)
    stand.arm(LIMITS)
    stand.close()
    stand.close()
    assert cell.closed == 2
    with pytest.raises(DriverError):
        stand.exchange(Command.rest())


@dataclass(frozen=True)
class CellTable:
    """A table of a joint sensor as the registry wants it."""

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid"}

    port: str
    scale: float = 1.0


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("a_cell")
    module.__dict__["Table"] = CellTable
    module.__dict__["opened"] = lambda table, *, clock: Cell(clock, period=table.scale)
    monkeypatch.setitem(sys.modules, "a_cell", module)
    for place in ("hil.stand.file.SENSORS", "hil.stand.devices.SENSORS"):
        monkeypatch.setattr(place, {"cell": Device("a cell", "a_cell:Table", "a_cell:opened")})


@pytest.mark.usefixtures("registered")
def test_a_stands_joint_sensor_is_joined_to_its_servo() -> None:
    stand = parse('[stand]\nbackend = "sim"\n[joint_sensor]\nkind = "cell"\nport = "p"\nscale = 0.25\n')
    servo, truth = open_servo(stand)
    servo.clock.sleep_until(0.3)
    sample = servo.exchange(Command.rest())
    assert (sample.t_joint, sample.joint_torque) == (0.25, 0.5)
    assert truth["gear_ratio"] == 1.0


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('port = "p"', "joint_sensor.kind: must be given; known are cell"),
        ('kind = "sell"', "did you mean 'cell'"),
        ("kind = 3", "unknown joint sensor '3'"),
        ('kind = "sell"\n[limits]\ntorque = 0.0', "limits.torque"),
        ('kind = "cell"\ncolour = 1', "joint_sensor.port: must be given"),
        ('kind = "cell"\nport = "p"\ncolour = 1', "joint_sensor.colour: no such key"),
    ],
)
def test_a_joint_sensors_table_is_checked_by_its_kind(table: str, message: str) -> None:
    with pytest.raises(WrongUse, match=message):
        parse(f"[stand]\n[joint_sensor]\n{table}\n")


def test_a_slow_and_late_sensor_leaves_stiffness_and_damping_what_they_are(tmp_path: Path) -> None:
    """80 readings a second, each up to 20 ms old when it is used, of a torque that is a closed form of the motion."""
    kc, bc = 0.02, 2e-4
    time = np.arange(5000) / 500.0
    slow, fast = 2.0 * math.pi * 1.3, 2.0 * math.pi * 7.1

    def dtheta(t: Array) -> Array:
        return 0.2 * np.sin(slow * t) + 0.1 * np.sin(fast * t)

    def rate(t: Array) -> Array:
        return 0.2 * slow * np.cos(slow * t) + 0.1 * fast * np.cos(fast * t)

    taken = np.maximum(np.floor((time - 7.5e-3) / 0.0125) * 0.0125, 0.0)
    torque = kc * dtheta(taken) + bc * rate(taken)
    channels = {"time": time, "read_time": time, "motor_position": dtheta(time), "dtheta": dtheta(time)}
    channels |= {"torque": torque, "joint_torque": torque, "joint_time": taken}
    path = tmp_path / "run.h5"
    write(path, Header(profile={"kind": "imported"}), channels)
    with Recording(path) as recording:
        signals = prepare(recording, parse('[stand]\ntorque_source = "joint"\n').stand)
    design = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])
    fitted = np.linalg.lstsq(design, signals.coupling_torque, rcond=None)[0]
    assert 700 < len(signals) <= 800
    assert fitted == pytest.approx([kc, bc], rel=2e-3)
    # as if every row were read when the motor was, damping would be lost in the delay
    unshifted = np.linalg.lstsq(np.column_stack([dtheta(time), rate(time)]), torque, rcond=None)[0]
    assert unshifted[1] < 0.5 * bc


@pytest.mark.parametrize("stamps", [5.0, -1e300])
def test_a_cell_whose_time_stands_still_is_said_to(make_recording: Maker, stamps: float) -> None:
    def change(channels: dict[str, Array]) -> None:
        channels["joint_torque"] = channels["torque"]
        channels["joint_time"] = np.full_like(channels["time"], stamps)

    with (
        Recording(make_recording(change=change)) as recording,
        pytest.raises(Untrustworthy, match=r"0 readings beside those of the angle.* stands still"),
    ):
        prepare(recording, None)


def test_a_recording_from_before_there_was_a_joint_time_is_read_as_it_is(make_recording: Maker) -> None:
    path = make_recording()
    with edited(path) as file:
        names = [name for name in CHANNELS if name != "joint_time"]
        rows = np.empty(len(file["samples/time"]), dtype=[(name, file["samples"][name].dtype) for name in names])
        for name in names:
            rows[name] = file["samples"][name]
        file.attrs["sha256"] = hashlib.sha256(rows.tobytes()).hexdigest()
        del file["samples/joint_time"]
    with Recording(path) as recording:
        assert recording.verify()
        assert np.isnan(recording.channel("joint_time")).all()
        assert len(prepare(recording, None)) > 1000
