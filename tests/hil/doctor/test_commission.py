"""Commissioning: which drives release their torque shows in what they do, not in what they report."""

from __future__ import annotations

import io
import json
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.servo import Quantity, Sample, Servo
from hil.acquisition.commissioning import last_outcome
from hil.acquisition.interrupt import StopRequest
from hil.cli.app import run
from hil.doctor import commission as commission_module
from hil.doctor import trials
from hil.doctor.checks import CheckList
from hil.doctor.commission import Report, commission
from hil.doctor.release import Load
from hil.doctor.trials import Trial, Try, make_trial, try_second_signal, try_silence
from hil.errors import WrongUse
from hil.guardian.servo import Watch
from hil.stand.file import Stand, parse
from sim_backend.fault_plan import FaultPlan, PlannedFault
from sim_backend.wire.dynamixel.emulator import serve
from sim_backend.wire.packets.bus import PacketTiming

from ...drivers import conftest as rigs
from ...drivers.conftest import Rig, nothing_is_left_behind

__all__ = ["nothing_is_left_behind"]

STAND = """
[stand]
backend = "dynamixel"
torque_stays_on_if_host_dies = true
[limits]
torque = {torque}
deflection = "20 rad"
velocity = 60.0
temperature = 80.0
"""


def with_watchdog() -> Rig:
    rig = rigs.new_foc(firmware="2.4-watchdog")
    rig.config = replace(rig.config, watchdog=0.1)
    return rig


WATCHED: dict[str, tuple[Callable[[], Rig], float]] = {
    "dynamixel": (rigs.new_rig, 0.03),
    "commander": (with_watchdog, 4e-3),
    "mit damiao": (rigs.mit_rig, 2.0),
    "robstride": (rigs.robstride_rig, 2.0),
    "moteus": (rigs.moteus_rig, 0.4),
    "cia402 epos4": (rigs.cia402_rig, 0.04),
    "cia402 epos2": (lambda: rigs.cia402_rig("epos2"), 0.04),
}
UNWATCHED: dict[str, tuple[Callable[[], Rig], float]] = {
    "dynamixel mx": (lambda: rigs.new_rig("mx-64"), 0.3),
    "feetech hls": (rigs.feetech_rig, 0.4),
    "odrive": (rigs.odrive_rig, 0.4),
    "mit ak": (lambda: rigs.mit_rig("ak80-9"), 2.0),
    "commander": (rigs.new_foc, 4e-3),
}


def on(monkeypatch: pytest.MonkeyPatch, rig: Rig, **changes: Any) -> None:
    """Let the trials open this drive."""

    def opened(stand: Stand, *, quantity: Quantity, watch: Watch) -> tuple[Servo, dict[str, float]]:
        del stand, quantity, watch
        return rig.open(**changes), {}

    monkeypatch.setattr(trials, "open_servo", opened)


def tried(rig: Rig, torque: float, trial: Try = try_silence, mode: Quantity = Quantity.TORQUE) -> Trial:
    checks = CheckList()
    made = make_trial(checks, parse(STAND.format(torque=torque)), mode, "watchdog", trial)
    assert checks.checks == []
    assert made is not None
    assert not rig.motor.enabled
    assert rig.motor.commanded == 0.0
    return made


def commissioned(torque: float = 0.03) -> tuple[CheckList, Report | None]:
    checks = CheckList()
    return checks, commission(checks, parse(STAND.format(torque=torque)), Quantity.TORQUE, lambda _: None)


def broken(rig: Rig, kind: str, at: float = 0.0) -> Rig:
    rig.motor.follow_plan(FaultPlan([PlannedFault(kind, at=at)]))
    return rig


@pytest.mark.parametrize("name", WATCHED)
def test_a_drive_whose_watchdog_acts_releases(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make, torque = WATCHED[name]
    rig = make()
    on(monkeypatch, rig)
    assert tried(rig, torque).left.releases


@pytest.mark.parametrize("name", WATCHED)
def test_a_drive_whose_watchdog_is_on_and_does_not_act_is_found_out(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make, torque = WATCHED[name]
    rig = broken(make(), "broken-watchdog")
    on(monkeypatch, rig)
    made = tried(rig, torque)
    assert made.left.releases is False
    assert made.left.share == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", UNWATCHED)
def test_a_drive_without_a_watchdog_does_not_release_its_torque(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make, torque = UNWATCHED[name]
    rig = make()
    on(monkeypatch, rig)
    assert tried(rig, torque).left.releases is False


def test_a_dynamixel_that_holds_its_position_when_its_watchdog_acts_does_not_release_its_torque(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = rigs.new_rig()
    on(monkeypatch, rig, mode="extended-position")
    assert tried(rig, 0.03, mode=Quantity.POSITION).left.releases is False


def test_a_drive_whose_pdos_stop_with_its_heartbeat_is_read_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = rigs.cia402_rig()
    lost = rig.device.connection_lost

    def pre_operational(code: int, now: float) -> None:
        lost(code, now)
        rig.device.node.state = 0x7F

    monkeypatch.setattr(rig.device, "connection_lost", pre_operational)
    on(monkeypatch, rig)
    assert tried(rig, 0.04).left.releases


def test_the_drive_gets_no_commands_for_at_most_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = rigs.moteus_rig()
    rig.config = replace(rig.config, watchdog=0.9)
    on(monkeypatch, rig)
    assert tried(rig, 0.4).seconds == 1.0
    rig.config = replace(rig.config, watchdog=2.0)
    with pytest.raises(WrongUse, match="set it to"):
        make_trial(CheckList(), parse(STAND.format(torque=0.4)), Quantity.TORQUE, "watchdog", try_silence)


def test_a_load_below_two_counts_of_the_drive_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    on(monkeypatch, rigs.new_rig("mx-64"))
    with pytest.raises(WrongUse, match="raise limits"):
        commissioned(0.06)


def test_the_second_signal_switches_the_torque_off_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = rigs.new_rig()
    on(monkeypatch, rig)
    made = tried(rig, 0.03, try_second_signal)
    assert made.left.releases
    assert made.seconds < 0.05


@pytest.mark.parametrize(("make", "torque"), [(rigs.moteus_rig, 0.4), (with_watchdog, 4e-3)], ids=["moteus", "foc"])
def test_a_drive_that_confirms_torque_off_and_keeps_its_torque_is_found_out(
    make: Callable[[], Rig], torque: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    on(monkeypatch, broken(make(), "ignored-off", at=0.3))
    checks, report = commissioned(torque)
    assert report is None
    assert any(check.message.startswith("CUT THE POWER") for check in checks.checks)


def test_a_good_outcome_is_kept_for_the_drive_and_its_firmware(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = rigs.moteus_rig()
    on(monkeypatch, rig)
    checks, report = commissioned(0.4)
    assert report is not None
    assert report.good
    assert report.verdict.startswith("commissioned until ")
    assert "serial number 3456789a" in report.verdict
    assert checks.ok
    on_stand = parse(STAND.format(torque=0.4))
    assert last_outcome(on_stand, report.info, Quantity.TORQUE) == report.outcome
    assert last_outcome(on_stand, report.info, Quantity.POSITION) is None
    assert last_outcome(on_stand, replace(report.info, firmware="1.2"), Quantity.TORQUE) is None
    monkeypatch.setattr(time, "time", lambda: report.outcome.time + 31 * 86400.0)
    assert last_outcome(on_stand, report.info, Quantity.TORQUE) is None


@pytest.mark.parametrize("own", [False, True], ids=["in a silence", "with the second signal"])
def test_a_signal_of_the_user_ends_a_commissioning_and_the_next_one_still_counts(
    monkeypatch: pytest.MonkeyPatch, *, own: bool
) -> None:
    def signalled(servo: Servo, load: Load) -> Trial | None:
        signal.raise_signal(signal.SIGTERM)
        if not own:
            return try_silence(servo, load)
        try_second_signal(servo, load)
        return None

    rig = rigs.new_rig()
    on(monkeypatch, rig)
    monkeypatch.setattr(StopRequest, "exit_follows", True)
    monkeypatch.setattr(commission_module, "_TRIALS", (("first", "", signalled), ("second", "", nothing_is_tried)))
    if own:
        monkeypatch.setattr(trials, "try_second_signal", signalled)
    before = signal.getsignal(signal.SIGTERM)
    checks, report = commissioned()
    assert report is None
    assert checks.signal == signal.SIGTERM
    assert signal.getsignal(signal.SIGTERM) == before
    assert not rig.motor.enabled


def nothing_is_tried(*_: object) -> None:
    raise AssertionError("torque after a signal to stop")


def test_the_simulated_servo_needs_none() -> None:
    with pytest.raises(WrongUse, match="needs no commissioning"):
        commission(CheckList(), parse(STAND.format(torque=1.0).replace("dynamixel", "sim")), Quantity.TORQUE, print)


def sample(torque: float, angle: float) -> Sample:
    return Sample(0.0, 0.0, motor_torque=torque, motor_position=angle)


def test_the_motor_s_torque_decides_even_where_friction_holds_the_deflection() -> None:
    load = Load([sample(0.0, 0.0)] * 5, [sample(0.1, 0.2)] * 5)
    assert load.left([sample(0.001, 0.19)]).releases
    assert load.left([sample(0.09, 0.0)]).releases is False


def test_without_a_torque_the_deflection_decides() -> None:
    nan = float("nan")
    load = Load([sample(nan, 0.0)] * 5, [sample(nan, 0.2)] * 5)
    assert load.left([sample(nan, 0.02)]).releases
    assert load.left([sample(nan, 0.19)]).releases is False


def test_a_load_within_the_noise_decides_nothing() -> None:
    noisy = [sample(0.1 * (-1) ** n, 0.0) for n in range(10)]
    assert Load(noisy, noisy).left([sample(0.0, 0.0)]).releases is None


@pytest.mark.study
def test_a_broken_watchdog_is_the_first_line_and_status_1_and_the_guardian_was_tried(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], busy_machine: None
) -> None:
    del busy_machine
    stand, link = tmp_path / "stand.toml", tmp_path / "tty"
    table = f'[dynamixel]\nport = "{link}"\nmodel = "xl330-m288"\nwatchdog = 0.2\nreply_timeout = 0.05\n'
    stand.write_text(STAND.format(torque=0.03) + table)
    broken = FaultPlan([PlannedFault("broken-watchdog", at=0.0)])
    with serve(link, "xl330-m288", timing=PacketTiming(), faults=broken) as line:
        status = run(["doctor", str(stand), "--commission", "--yes", "--rate", "100"])
        assert not line._peer.devices[0].motor.enabled  # type: ignore[attr-defined]
    said = capfd.readouterr()
    assert status == 1, said
    assert said.out.startswith("the drive DOES NOT RELEASE ITS TORQUE: ")
    assert "ok          guardian: " in said.out
    assert "will pull at up to 0.003 N m" in said.err


def test_nothing_is_driven_without_a_yes(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    stand = tmp_path / "stand.toml"
    stand.write_text(STAND.format(torque=0.03) + '[dynamixel]\nport = "/dev/null"\nmodel = "xl330-m288"\n')
    assert run(["doctor", str(stand), "--commission"]) == 2
    assert "nothing was driven: answer y, or add --yes" in capfd.readouterr().err
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    assert run(["doctor", str(stand), "--move"]) == 2
    said = capfd.readouterr().err
    assert "model xl330-m288, port /dev/null, id 1) will swing with up to 0.0015 N m at the joint for 3 s." in said


def test_the_json_has_every_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    on(monkeypatch, rigs.new_rig())
    _, report = commissioned()
    assert report is not None
    table = json.loads(json.dumps(report.as_json(), allow_nan=False))
    assert table["ok"] is True
    assert table["guardian"] is None  # of a drive in this process
    assert table["watchdog"]["releases"] is True
    assert table["second_signal"]["seconds"] < 0.05
