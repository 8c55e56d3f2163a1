"""`hil doctor` against the emulated servo: its verdicts on sound and faulty stands, and that no torque is left on."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import hil.doctor.examine
import hil.doctor.tune
from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.identity import search
from drivers.dynamixel.servo import DynamixelServo
from drivers.ports import latency_timer, set_latency_timer
from drivers.servo import Command, DriverError, Quantity, Sample, Servo
from hil.acquisition.interrupt import StopRequest
from hil.cli.app import run
from hil.doctor.checks import CheckList
from hil.doctor.examine import examine
from hil.guardian.servo import Watch
from hil.stand.file import Stand, parse
from sim_backend.parameters import CouplingParameters
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.emulator import serve
from sim_backend.wire.faults import DropReplies, Unplug
from sim_backend.wire.packets.bus import PacketTiming

from ...drivers.conftest import FEETECH_LIMITS, feetech_rig, new_rig, nothing_is_left_behind, small_joint

__all__ = ["nothing_is_left_behind"]

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

Examine = Callable[..., CheckList]


def stand_at(port: object) -> Stand:
    return parse(STAND.format(port=port))


@pytest.fixture
def make_rig() -> Callable[..., Any]:
    return new_rig


@pytest.fixture
def examine_rig(monkeypatch: pytest.MonkeyPatch) -> Examine:
    def run_it(rig: Any, quantity: Quantity = Quantity.TORQUE, **words: Any) -> CheckList:
        def opened(stand: Stand, *, quantity: Quantity, watch: Watch) -> tuple[Servo, dict[str, float]]:
            del watch
            table = replace(stand.devices["dynamixel"], port="loopback").for_quantity(quantity)
            return rig.open(mode=table.mode), {}

        monkeypatch.setattr(hil.doctor.examine, "open_servo", opened)
        checks = CheckList()
        examine(checks, stand_at("loop://"), quantity, **{"rate": 200.0, "move": True} | words)
        return checks

    return run_it


def verdicts(checks: CheckList) -> dict[str, str]:
    """All but what depends on the machine that runs the tests."""
    return {check.name: check.verdict.value for check in checks.checks if check.name != "real time"}


def message(checks: CheckList, name: str) -> str:
    return next(check.message for check in checks.checks if check.name == name)


@pytest.mark.parametrize("quantity", [Quantity.POSITION])
def test_a_sound_stand_passes_every_check_is_left_with_its_torque_off_and_no_file_is_written(
    make_rig: Callable[..., Any], examine_rig: Examine, quantity: Quantity, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("h5py.File", lambda *_, **__: pytest.fail("a file was opened"))
    rig = make_rig()
    checks = examine_rig(rig, quantity)
    names = ["connection", "bus", "readings", "neighbours", "stop", "move", "signs", "lock", "watchdog"]
    assert verdicts(checks) == dict.fromkeys(names, "ok")
    assert message(checks, "signs").endswith("set sign = -1 in [dynamixel]")
    assert checks.info is not None
    assert checks.info.model == "xl330-m288"
    assert checks.bus is not None
    # 14 + 38 bytes at 1 Mbaud and 1 ms in the adapter, and the loopback reads in steps of its poll
    assert 400.0 < checks.bus.rate == pytest.approx(1.0 / (52e-5 + 1e-3), rel=2e-3)
    assert not rig.device.motor.enabled
    assert rig.port.closed


def test_a_drive_without_a_watchdog_is_not_moved(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    rig.config = replace(rig.config, watchdog=0.0)
    checks = examine_rig(rig)
    assert "torque_stays_on_if_host_dies" in message(checks, "move")
    assert verdicts(checks)["move"] == "error"
    assert verdicts(checks)["watchdog"] == "warning"
    assert rig.device.motor.position == 0.0


def test_nothing_moves_without_the_option(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    checks = examine_rig(rig, move=False)
    assert verdicts(checks)["signs, lock"] == "not checked"
    assert checks.ok
    assert rig.device.motor.position == 0.0


def test_a_joint_that_is_not_locked_is_an_error(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    free = small_joint(CouplingParameters(stiffness=1e-5, damping=1e-6, coulomb_friction=0.0))
    rig.bus.devices[0] = DynamixelDevice(
        "xl330-m288", parameters=replace(free, motor=replace(free.motor, inertia=3e-4))
    )
    checks = examine_rig(rig)
    assert verdicts(checks)["lock"] == "error"
    assert "lock the joint" in message(checks, "lock")
    assert not rig.device.motor.enabled


def test_limits_beyond_a_servos_overload_protection_are_a_warning_with_its_registers(
    make_rig: Callable[..., Any], examine_rig: Examine
) -> None:
    rig = make_rig()
    rig.device.registers.put("pwm_limit", 40)  # of 885: the servo makes 27 mN m of its 600
    checks = examine_rig(rig, move=False)
    assert verdicts(checks)["overload"] == "warning"
    assert "0.0271 N m is an overload" in message(checks, "overload")
    assert "Shutdown(63) is 53" in message(checks, "overload")
    rig.device.registers.put("shutdown", 53 & ~0x20)
    assert "overload" not in verdicts(examine_rig(rig, move=False))


@pytest.mark.parametrize(("model", "number"), [("sts3215", 36), ("scs0009", 39)])
def test_the_overload_of_a_feetech_is_a_share_of_the_torque_limit(model: str, number: int) -> None:
    rig = feetech_rig(model)
    servo = rig.open(mode="position")
    overload = servo.overload(FEETECH_LIMITS)
    assert overload.torque == pytest.approx(0.8 * FEETECH_LIMITS.torque)
    assert f"after 2 s the servo reduces its torque to 20 %: Overload Torque({number}) is 80 %" in overload.acts
    servo.close()


def test_a_watchdog_that_does_not_trip_is_an_error(
    make_rig: Callable[..., Any], examine_rig: Examine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    monkeypatch.setattr(rig.device, "_trip", lambda: None)
    checks = examine_rig(rig, move=False)
    assert verdicts(checks)["watchdog"] == "error"
    assert "keep a switch" in message(checks, "watchdog")
    assert not rig.device.motor.enabled


def test_a_torque_that_does_not_go_off_raises_the_alarm(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    rig.device.life.ignores_off = True
    checks = examine_rig(rig, move=False)
    assert verdicts(checks)["torque off"] == "error"
    assert "CUT THE POWER" in message(checks, "torque off")


def test_a_torque_off_that_is_not_confirmed_is_requested_again(
    make_rig: Callable[..., Any], examine_rig: Examine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    disarm = DynamixelServo.disarm
    refused: list[int] = []

    def unconfirmed(self: DynamixelServo) -> None:
        if rig.device.motor.enabled and len(refused) < 5:
            refused.append(1)
            raise DriverError("it is still on")
        disarm(self)

    monkeypatch.setattr(DynamixelServo, "disarm", unconfirmed)
    checks = examine_rig(rig, move=False)
    assert len(refused) == 5
    assert "torque off" not in verdicts(checks)
    assert not rig.device.motor.enabled


def test_a_latched_fault_is_reported_with_its_remedy(make_rig: Callable[..., Any], examine_rig: Examine) -> None:
    rig = make_rig()
    rig.device.fail(0x04)
    checks = examine_rig(rig)
    assert verdicts(checks)["drive"] == "error"
    assert "too hot" in message(checks, "drive")


def test_a_link_that_loses_many_replies_is_an_error_that_names_its_keys_in_the_stand_file(
    make_rig: Callable[..., Any], examine_rig: Examine
) -> None:
    rig = make_rig()
    rig.bus.faults.inject(DropReplies(after=20, count=10))
    checks = examine_rig(rig, move=False)
    assert verdicts(checks)["bus"] == "error"
    assert "10 lost" in message(checks, "bus")
    assert message(checks, "bus").endswith("(in the stand file: dynamixel.baudrate, dynamixel.reply_timeout)")


@pytest.mark.study
def test_a_link_that_is_too_slow_is_a_warning_with_the_rate_it_reaches(
    make_rig: Callable[..., Any], examine_rig: Examine
) -> None:
    rig = make_rig(baudrate=57600)
    rig.config = replace(rig.config, baudrate=57600)
    checks = examine_rig(rig)
    assert verdicts(checks)["bus"] == "warning"
    assert "record with --rate" in message(checks, "bus")
    assert verdicts(checks)["lock"] == "ok"


def test_a_signal_in_the_middle_of_the_jog_leaves_the_torque_off(
    make_rig: Callable[..., Any], examine_rig: Examine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    exchange = DynamixelServo.exchange
    pushes: list[float] = []

    def interrupting(self: DynamixelServo, command: Command) -> Sample:
        if rig.device.motor.enabled and command.value:
            pushes.append(command.value)
            if len(pushes) == 500:
                os.kill(os.getpid(), signal.SIGTERM)
        return exchange(self, command)

    monkeypatch.setattr(DynamixelServo, "exchange", interrupting)
    checks = examine_rig(rig)
    assert checks.signal == signal.SIGTERM
    assert "watchdog" not in verdicts(checks)
    assert not rig.device.motor.enabled


@pytest.mark.study
def test_servos_are_found_at_other_baud_rates_and_ids(make_rig: Callable[..., Any]) -> None:
    rig = make_rig(baudrate=57600, ident=7)
    rig.bus.devices.append(DynamixelDevice("xm430-w350", 9, baudrate=57600))
    config = DynamixelConfig(port="loopback", model="xl330-m288")
    assert search(config, rig.clock, rig.port) == [
        "a xl330-m288 answers with id 7 at 57600 baud",
        "a xm430-w350 answers with id 9 at 57600 baud",
    ]
    assert not any(device.motor.enabled for device in rig.bus.devices)


def test_the_command_names_the_settings_at_which_a_servo_answers(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.packets.bus._ROLL_CALL", 0.1)
    monkeypatch.setattr("drivers.dynamixel.identity.RATES", (1_000_000, 57_600))
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
    with serve(link, "xl330-m288", timing=PacketTiming()):
        assert run(["doctor", str(stand), "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert (answer["schema"], answer["ok"], answer["drive"]["model"]) == ("hil-doctor/2", True, "xl330-m288")
    assert answer["bus"]["exchanges"] > 10
    assert {check["name"] for check in answer["checks"]} >= {
        "port",
        "connection",
        "bus",
        "readings",
        "stop",
        "watchdog",
    }


def test_a_stand_whose_port_is_not_there_is_a_stand_that_failed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    stand = tmp_path / "stand.toml"
    stand.write_text(STAND.format(port=tmp_path / "none"))
    assert run(["doctor", str(stand)]) == 3
    assert "does not exist: check the cable" in capfd.readouterr().out


def test_a_link_that_is_lost_in_the_middle_is_an_error_and_no_traceback(
    make_rig: Callable[..., Any], examine_rig: Examine
) -> None:
    rig = make_rig()
    rig.bus.faults.inject(Unplug(after=50))
    checks = examine_rig(rig)
    assert verdicts(checks)["drive"] == "error"
    assert rig.port.closed


@pytest.mark.study
def test_tuning_finds_the_rate_that_the_wire_permits_and_names_the_key_that_gets_it(
    make_rig: Callable[..., Any], examine_rig: Examine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    opened: list[float] = []

    def at_rest(stand: Stand, *, quantity: Quantity) -> tuple[Servo, dict[str, float]]:
        table = stand.devices["dynamixel"].for_quantity(quantity)
        opened.append(table.return_delay)
        return rig.open(mode=table.mode, return_delay=table.return_delay), {}

    monkeypatch.setattr(hil.doctor.tune, "_TICKS", 100)
    monkeypatch.setattr(hil.doctor.tune, "open_servo", at_rest)
    slow = f"{STAND.format(port='loop://')}return_delay = 500e-6\n"
    monkeypatch.setattr(__name__ + ".stand_at", lambda _: parse(slow))
    checks = examine_rig(rig, move=False, tuned=True)
    assert verdicts(checks)["tune"] == "warning"
    said = message(checks, "tune")
    rates = [float(found) for found in re.findall(r"([\d.]+) Hz", said)]
    assert opened[:2] == [500e-6, 0.0]
    assert rates[1] < rates[0] < 1.0 / (52e-5 + 1e-3)
    assert said.endswith("set dynamixel.return_delay = 0")
    assert not rig.device.motor.enabled


def test_tuning_a_drive_without_a_return_delay_names_the_rate_and_no_key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hil.doctor.tune, "_TICKS", 100)
    stand = parse('[stand]\nbackend = "sim"\n[limits]\ntorque = 0.03\ndeflection = 1.0\nvelocity = 100.0\n')
    examine(checks := CheckList(), stand, Quantity.TORQUE, rate=200.0, move=False, tuned=True)
    assert verdicts(checks)["tune"] == "ok"
    assert "is the highest rate" in message(checks, "tune")
    assert "return_delay" not in message(checks, "tune")


@pytest.mark.study
def test_a_rate_at_which_replies_are_lost_is_not_one_at_which_they_are_in_time(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    servo = rig.open()
    whole = hil.doctor.tune.highest_rate(servo, stop := StopRequest())
    rig.bus.faults.inject(DropReplies(after=310, count=6))  # of 2000, two may be missing
    reached = hil.doctor.tune.highest_rate(servo, stop)
    assert reached.share >= 0.999
    assert reached.rate < whole.rate
    servo.close()


def test_a_latency_timer_is_set_where_the_user_may_and_named_where_not(tmp_path: Path) -> None:
    folder = tmp_path / "bus/usb-serial/devices/ttyUSB0"
    assert not set_latency_timer("ttyUSB0", 1, tmp_path)
    folder.mkdir(parents=True)
    (folder / "latency_timer").write_text("16")
    assert set_latency_timer("ttyUSB0", 1, tmp_path)
    assert latency_timer("ttyUSB0", tmp_path) == 1


def test_a_can_stand_is_not_answered_with_serial_ports(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "stand.toml"
    path.write_text(
        '[stand]\nbackend = "odrive"\n[limits]\ntorque = 1\ndeflection = 1\nvelocity = 1\n'
        '[odrive]\ninterface = "socketcan"\nchannel = "can77"\ntorque_constant = 0.04\n'
    )
    assert run(["doctor", str(path)]) == 3
    said = capfd.readouterr().out
    assert "serial port" not in said
    assert said.startswith("error       port: there is no CAN interface can77")
    assert "odrive.channel" in said
