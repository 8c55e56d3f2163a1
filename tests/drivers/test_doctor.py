"""`hil doctor` against the emulated servo: what it finds right, what it finds wrong, and that nothing is left on."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import hil.doctor.examine
from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.scan import search
from drivers.dynamixel.servo import DynamixelServo
from drivers.servo import Command, DriverError, Quantity, Sample, Servo
from hil.cli.app import run
from hil.doctor.checks import Examination
from hil.doctor.examine import examine
from hil.stand.file import Stand, parse
from sim_backend.parameters import CouplingParameters
from sim_backend.wire.dynamixel.bus import DynamixelTiming
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.emulator import serve
from sim_backend.wire.dynamixel.regulator import joint_at_horn
from sim_backend.wire.dynamixel.tables import MODELS
from sim_backend.wire.faults import DropReplies, Unplug

STAND = """
[stand]
backend = "dynamixel"
[limits]
torque = 0.03
deflection = 1.5
velocity = 60.0
temperature = 65.0
[dynamixel]
port = "{port}"
model = "xl330-m288"
"""

Examine = Callable[..., Examination]


def stand_at(port: object) -> Stand:
    return parse(STAND.format(port=port))


@pytest.fixture
def examine_rig(monkeypatch: pytest.MonkeyPatch) -> Examine:
    def run_it(rig: Any, quantity: Quantity = Quantity.TORQUE, **words: Any) -> Examination:
        def opened(stand: Stand, *, quantity: Quantity) -> tuple[Servo, dict[str, float]]:
            table = replace(stand.devices["dynamixel"], port="loopback").for_quantity(quantity)
            return rig.open(mode=table.mode), {}

        monkeypatch.setattr(hil.doctor.examine, "open_servo", opened)
        found = Examination()
        examine(found, stand_at("loop://"), quantity, **{"rate": 400.0, "move": True} | words)
        return found

    return run_it


def verdicts(found: Examination) -> dict[str, str]:
    return {check.name: check.verdict.value for check in found.checks}


def message(found: Examination, name: str) -> str:
    return next(check.message for check in found.checks if check.name == name)


@pytest.mark.parametrize("quantity", list(Quantity))
def test_a_sound_stand_passes_every_check_and_is_left_with_its_torque_off(
    make_rig: Callable[..., Any], examine_rig: Examine, quantity: Quantity
) -> None:
    rig = make_rig()
    found = examine_rig(rig, quantity)
    names = ["connection", "bus", "readings", "stop", "move", "signs", "lock", "watchdog"]
    assert verdicts(found) == dict.fromkeys(names, "ok")
    assert found.info is not None
    assert found.info.model == "xl330-m288"
    assert found.bus is not None
    # 14 + 38 bytes at 1 Mbaud and 1 ms in the adapter, and the loopback reads in steps of its poll
    assert 400.0 < found.bus.rate < 1.0 / (52e-5 + 1e-3)
    assert not rig.device.torque_on
    assert rig.port.opened == 0


def test_nothing_moves_unless_it_was_asked_for(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    found = examine_rig(rig, move=False)
    assert verdicts(found)["signs, lock"] == "not checked"
    assert found.ok
    assert rig.device.motor.position == 0.0


def test_a_joint_that_is_not_locked_is_found_out(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    free = joint_at_horn(MODELS["xl330-m288"], CouplingParameters(stiffness=1e-5, damping=1e-6, coulomb_friction=0.0))
    rig.bus.devices[0] = DynamixelDevice(
        "xl330-m288", parameters=replace(free, motor=replace(free.motor, inertia=3e-4))
    )
    found = examine_rig(rig)
    assert verdicts(found)["lock"] == "problem"
    assert "lock the joint" in message(found, "lock")
    assert not rig.device.torque_on


def test_a_watchdog_that_does_nothing_is_found_out(
    make_rig: Callable[..., Any], examine_rig: Examine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    monkeypatch.setattr(rig.device, "_trip", lambda: None)
    found = examine_rig(rig, move=False)
    assert verdicts(found)["watchdog"] == "problem"
    assert "keep a switch" in message(found, "watchdog")
    assert not rig.device.torque_on


def test_a_drive_whose_torque_does_not_go_off_is_cried_out(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    rig.device.ignores_torque_off = True
    found = examine_rig(rig, move=False)
    assert verdicts(found)["torque off"] == "problem"
    assert "CUT THE POWER" in message(found, "torque off")


def test_a_torque_off_that_is_not_heard_is_asked_for_again(
    make_rig: Callable[..., Any], examine_rig: Examine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    disarm = DynamixelServo.disarm
    refused: list[int] = []

    def deaf(self: DynamixelServo) -> None:
        if rig.device.torque_on and len(refused) < 5:
            refused.append(1)
            raise DriverError("it is still on")
        disarm(self)

    monkeypatch.setattr(DynamixelServo, "disarm", deaf)
    found = examine_rig(rig, move=False)
    assert len(refused) == 5
    assert "torque off" not in verdicts(found)
    assert not rig.device.torque_on


def test_a_latched_fault_is_told_with_its_remedy(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    rig.device.fail(0x04)
    found = examine_rig(rig)
    assert verdicts(found)["drive"] == "problem"
    assert "too hot" in message(found, "drive")


def test_a_link_that_loses_many_replies_is_a_problem(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    rig.bus.faults.inject(DropReplies(after=20, count=40))
    found = examine_rig(rig, move=False)
    assert verdicts(found)["bus"] == "problem"
    assert "40 lost" in message(found, "bus")


def test_a_link_that_is_too_slow_is_told_with_the_rate_it_manages(
    make_rig: Callable[..., Any], examine_rig: Examine
) -> None:
    rig = make_rig(baudrate=57600)
    rig.config = replace(rig.config, baudrate=57600)
    found = examine_rig(rig)
    assert verdicts(found)["bus"] == "note"
    assert "record with --rate" in message(found, "bus")
    assert verdicts(found)["lock"] == "ok"


def test_an_order_to_stop_in_the_middle_of_the_move_leaves_the_torque_off(
    make_rig: Callable[..., Any], examine_rig: Examine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    exchange = DynamixelServo.exchange
    pushes: list[float] = []

    def interrupting(self: DynamixelServo, command: Command) -> Sample:
        if rig.device.torque_on and command.value:
            pushes.append(command.value)
            if len(pushes) == 500:
                os.kill(os.getpid(), signal.SIGTERM)
        return exchange(self, command)

    monkeypatch.setattr(DynamixelServo, "exchange", interrupting)
    found = examine_rig(rig)
    assert found.signal == signal.SIGTERM
    assert "watchdog" not in verdicts(found)
    assert not rig.device.torque_on


def test_servos_are_found_at_other_baud_rates_and_ids(make_rig: Callable[..., Any]) -> None:
    rig = make_rig(baudrate=57600, ident=7)
    rig.bus.devices.append(DynamixelDevice("xm430-w350", 9, baudrate=57600))
    config = DynamixelConfig(port="loopback", model="xl330-m288")
    assert search(config, rig.clock, rig.port) == [
        "a xl330-m288 answers with id 7 at 57600 baud",
        "a xm430-w350 answers with id 9 at 57600 baud",
    ]
    assert not any(device.torque_on for device in rig.bus.devices)


def test_the_command_says_where_the_servo_really_is(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.dynamixel.bus._ROLL_CALL", 0.1)
    stand = tmp_path / "stand.toml"
    link = tmp_path / "ttyDXL"
    stand.write_text(STAND.format(port=link))
    with serve(link, "xl330-m288", (3,), baudrate=57600):
        assert run(["doctor", str(stand)]) == 3
    assert "a xl330-m288 answers with id 3 at 57600 baud: correct the stand file" in capfd.readouterr().out


def test_the_command_gives_one_json_object(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    stand = tmp_path / "stand.toml"
    link = tmp_path / "ttyDXL"
    stand.write_text(STAND.format(port=link) + "reply_timeout = 0.3\nwatchdog = 1.0\n")
    with serve(link, "xl330-m288", timing=DynamixelTiming()):
        assert run(["doctor", str(stand), "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert (told["schema"], told["ok"], told["drive"]["model"]) == ("hil-doctor/1", True, "xl330-m288")
    assert told["bus"]["exchanges"] > 10
    assert {check["name"] for check in told["checks"]} >= {"port", "connection", "bus", "readings", "stop", "watchdog"}


def test_a_stand_whose_port_is_not_there_is_a_stand_that_failed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    stand = tmp_path / "stand.toml"
    stand.write_text(STAND.format(port=tmp_path / "none"))
    assert run(["doctor", str(stand)]) == 3
    assert "is not there: check the cable" in capfd.readouterr().out


def test_a_drive_that_dies_in_the_middle_is_a_problem_and_no_traceback(
    make_rig: Callable[..., Any], examine_rig: Examine
) -> None:
    rig = make_rig()
    rig.bus.faults.inject(Unplug(after=50))
    found = examine_rig(rig)
    assert verdicts(found)["drive"] == "problem"
    assert rig.port.opened == 0
