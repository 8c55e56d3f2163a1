"""The torque log of emulated drives: what it says, when, and that a kill does not take it away."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.servo import DynamixelServo
from drivers.servo import Command, Limits, Quantity
from hil.cli.app import run
from sim_backend.wire.canbus.impedance import CanMotor, Impedance
from sim_backend.wire.catalogue import EMULATORS, make
from sim_backend.wire.default_joint import scaled_joint
from sim_backend.wire.life import Life
from sim_backend.wire.torque_log import COLUMNS, TorqueLog

LIMITS = Limits(torque=0.03, velocity=40.0, temperature=65.0, position=(-3.0, 3.0))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="ascii", newline="") as file:
        return list(csv.DictReader(file))


class Drive:
    def __init__(self) -> None:
        self.motor = CanMotor(scaled_joint(1.0, 0.1, 1.0), Impedance())
        self.tripped = False
        self.life = Life(self.motor, 1000.0, watches=lambda: False, tripped=lambda: self.tripped)


def test_a_row_is_written_at_every_change_of_torque_output_stage_and_watchdog(tmp_path: Path) -> None:
    drive, log = Drive(), TorqueLog(tmp_path / "torque.csv")
    log.watch_all([drive.life])
    drive.motor.enable()
    drive.motor.follow(Impedance(feedforward=0.25))
    drive.motor.run(0.05)
    drive.tripped = True
    drive.motor.run(0.06)
    drive.motor.disable()
    drive.motor.run(0.2)
    found = rows(tmp_path / "torque.csv")  # before it is closed: a kill takes nothing away
    log.close()
    assert tuple(found[0]) == COLUMNS
    assert [row["enabled"] for row in (found[0], found[1], found[-1])] == ["0", "1", "0"]
    driven = [row for row in found if row["commanded_Nm"] == "0.25"]
    assert driven[0]["watchdog"] == "off"
    assert driven[-1]["watchdog"] == "tripped"
    assert float(driven[-1]["acting_Nm"]) == pytest.approx(0.25, rel=0.01)
    assert float(driven[-1]["time_s"]) == pytest.approx(1000.06)
    assert (found[-1]["commanded_Nm"], found[-1]["acting_Nm"]) == ("0", "0")


def test_an_unchanged_drive_writes_no_row(tmp_path: Path) -> None:
    drive, log = Drive(), TorqueLog(tmp_path / "torque.csv")
    log.watch_all([drive.life])
    for tick in range(1000):
        drive.motor.run(tick * 1e-3)
    log.close()
    assert len(rows(tmp_path / "torque.csv")) == 1


@pytest.mark.study
def test_the_rows_up_to_a_kill_of_the_emulator_are_there(tmp_path: Path) -> None:
    link, path = tmp_path / "ttyDXL", tmp_path / "torque.csv"
    words = ["emulate", "dynamixel", "--link", str(link), "--log", str(path)]
    code = "from hil.cli.app import main; main()"
    with subprocess.Popen([sys.executable, "-c", code, *words], stderr=subprocess.PIPE, text=True) as emulator:
        try:
            assert emulator.stderr is not None
            emulator.stderr.readline()
            servo = DynamixelServo(DynamixelConfig(port=str(link), model="xl330-m288", reply_timeout=0.3, watchdog=1.0))
            servo.arm(LIMITS)
            for _ in range(5):
                servo.exchange(Command(Quantity.TORQUE, 0.02))
            emulator.send_signal(signal.SIGKILL)
            emulator.wait()
        finally:
            emulator.kill()
    servo.close()
    assert float(rows(path)[-1]["commanded_Nm"]) == pytest.approx(0.02, rel=0.1)
    assert rows(path)[-1]["enabled"] == "1"
    assert rows(path)[-1]["watchdog"] == "on"


def test_every_emulated_drive_takes_a_log_and_a_torque_cell_does_not(tmp_path: Path) -> None:
    for name in EMULATORS:
        log = TorqueLog(tmp_path / f"{name}.csv")
        options = {"link": tmp_path / name, "log": log}
        if name == "loadcell":
            with pytest.raises(ValueError, match="takes no --log"):
                make(name, options)
            continue
        served = make(name, options)
        served.stop()
        served.serve()
        assert [row["commanded_Nm"] for row in rows(tmp_path / f"{name}.csv")] == ["0"]


def test_a_log_never_replaces_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "torque.csv"
    path.write_text("mine")
    assert run(["emulate", "dynamixel", "--link", str(tmp_path / "tty"), "--log", str(path)]) == 2
    assert capsys.readouterr().err == f"hil: {path} exists: choose another name with --log\n"
    assert path.read_text() == "mine"
