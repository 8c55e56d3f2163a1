"""A program that dies during a run, over a pty: the drive stops when no request arrives any more."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.canbus.slcan import slcan_line
from sim_backend.wire.cia402.device import Cia402Device
from sim_backend.wire.commander.emulator import CommanderTiming, new_board
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.moteus.device import MoteusDevice
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.robstride.device import RobstrideDevice
from sim_backend.wire.uart.pty_line import PtyLine

ROOT = Path(__file__).parents[2]
CRASHES = """
import os, signal, sys
from drivers.{family}.config import {name}Config
from drivers.{family}.servo import {name}Servo
from drivers.servo import Command, Limits, Quantity
servo = {name}Servo({name}Config({where}, reply_timeout=0.3, watchdog=1.0))
servo.arm(Limits(torque={torque}, velocity=60.0, temperature=65.0, position=(-3.0, 3.0)))
servo.exchange(Command(Quantity.TORQUE, {torque} / 2.0))
os.kill(os.getpid(), signal.SIGKILL)
"""


class Case(NamedTuple):
    """where: the first arguments of the configuration. torque: the limit, N m. device: makes the drive, now."""

    where: str
    torque: float
    device: Callable[[float], Any]


def board(now: float) -> Any:
    made = new_board(firmware="2.4-watchdog", timing=CommanderTiming(), now=now)
    made.watchdog = 1.0
    return made


CAN = '"slcan", sys.argv[1]'
CASES = {
    "Mit": Case(f'{CAN}, "dm-j4310"', 0.4, lambda now: MitDevice("dm-j4310", now=now)),
    "Moteus": Case(CAN, 0.4, lambda now: MoteusDevice(now=now)),
    "Cia402": Case(f'{CAN}, "epos4"', 0.4, lambda now: Cia402Device(now=now)),
    "Robstride": Case(f'{CAN}, "rs00"', 0.4, lambda now: RobstrideDevice(now=now)),
    "Dynamixel": Case('sys.argv[1], "xl330-m288"', 0.03, lambda now: DynamixelDevice("xl330-m288", now=now)),
    "Commander": Case("sys.argv[1], torque_constant=0.0145", 4e-3, board),
}
QUICK = {"Mit", "Dynamixel", "Commander"}


@pytest.mark.parametrize("name", [pytest.param(one, marks=() if one in QUICK else pytest.mark.study) for one in CASES])
def test_a_killed_program_leaves_no_torque_once_the_watchdog_has_run_out(tmp_path: Path, name: str) -> None:
    where, torque, make = CASES[name]
    device = make(time.monotonic())
    bus: Any = device
    if "slcan" in where:
        bus = CanBus([device])
    elif name == "Dynamixel":
        bus = PacketBus([device])
    serve: Any = slcan_line if "slcan" in where else PtyLine
    with serve(tmp_path / "tty", bus) as line:
        crash = CRASHES.format(family=name.lower(), name=name, where=where, torque=torque)
        done = subprocess.run([sys.executable, "-c", crash, str(line.link)], cwd=ROOT, check=False, timeout=60)
        assert done.returncode == -signal.SIGKILL
        with line.lock:
            bus.advance(line.now() + 1.05)
            assert abs(device.motor.torque) < 1e-6
            assert name == "Dynamixel" or not device.motor.enabled  # it stays on at a goal of zero
