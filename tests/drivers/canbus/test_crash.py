"""A program that dies during a run, on a serial CAN adapter: the drive stops when no frame arrives any more."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.canbus.slcan import slcan_line
from sim_backend.wire.cia402.device import Cia402Device
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.moteus.device import MoteusDevice
from sim_backend.wire.robstride.device import RobstrideDevice

CRASHES = """
import os, signal, sys
from drivers.servo import Command, Limits, Quantity
if sys.argv[1] == "moteus":
    from drivers.moteus.servo import MoteusServo as Servo
    from drivers.moteus.config import MoteusConfig
    config = MoteusConfig("slcan", sys.argv[2], reply_timeout=0.3, watchdog=1.0)
elif sys.argv[1] == "cia402":
    from drivers.cia402.servo import Cia402Servo as Servo
    from drivers.cia402.config import Cia402Config
    config = Cia402Config("slcan", sys.argv[2], "epos4", reply_timeout=0.3, watchdog=1.0)
elif sys.argv[1] == "robstride":
    from drivers.robstride.servo import RobstrideServo as Servo
    from drivers.robstride.config import RobstrideConfig
    config = RobstrideConfig("slcan", sys.argv[2], "rs00", reply_timeout=0.3, watchdog=1.0)
else:
    from drivers.mit.servo import MitServo as Servo
    from drivers.mit.config import MitConfig
    config = MitConfig("slcan", sys.argv[2], "dm-j4310", reply_timeout=0.3, watchdog=1.0)
servo = Servo(config)
servo.arm(Limits(torque=0.4, velocity=60.0, temperature=75.0, position=(-3.0, 3.0)))
servo.exchange(Command(Quantity.TORQUE, 0.2))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize(
    "kind", ["mit", *(pytest.param(kind, marks=pytest.mark.study) for kind in ("moteus", "cia402", "robstride"))]
)
def test_a_killed_program_leaves_no_torque_once_the_watchdog_has_run_out(tmp_path: Path, kind: str) -> None:
    bus = CanBus([])
    with slcan_line(tmp_path / "ttyCAN", bus) as line:
        now = line.now()
        makers: dict[str, Any] = {"moteus": MoteusDevice, "cia402": Cia402Device, "robstride": RobstrideDevice}
        device = makers[kind](now=now) if kind in makers else MitDevice("dm-j4310", now=now)
        bus.nodes.append(device)
        root = Path(__file__).parents[3]
        command = [sys.executable, "-c", CRASHES, kind, str(line.link)]
        done = subprocess.run(command, cwd=root, check=False, timeout=60)
        assert done.returncode == -signal.SIGKILL
        with line.lock:
            bus.advance(line.now() + 1.05)
            assert device.motor.torque == 0.0
            assert device.motor.demand == 0.0
