"""A program that dies during a run: the servo stops when no request arrives any more."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.uart.pty_line import PtyLine

CRASHES = """
import os, signal, sys
from drivers.dynamixel.servo import DynamixelServo
from drivers.dynamixel.config import DynamixelConfig
from drivers.servo import Command, Limits, Quantity
config = DynamixelConfig(port=sys.argv[1], model="xl330-m288", reply_timeout=0.3, watchdog=1.0)
servo = DynamixelServo(config)
servo.arm(Limits(torque=0.03, velocity=40.0, temperature=65.0, position=(-3.0, 3.0)))
servo.exchange(Command(Quantity.TORQUE, 0.02))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_program_leaves_no_current_once_the_watchdog_has_run_out(tmp_path: Path) -> None:
    bus = PacketBus([])
    with PtyLine(tmp_path / "tty", bus) as line:
        bus.devices.append(DynamixelDevice("xl330-m288", now=line.now()))
        root = Path(__file__).parents[3]
        done = subprocess.run([sys.executable, "-c", CRASHES, str(line.link)], cwd=root, check=False, timeout=60)
        assert done.returncode == -signal.SIGKILL
        with line.lock:
            device = bus.devices[0]
            bus.advance(line.now() + 1.05)
            assert device.registers.get("goal_current") == 0
            assert device.tripped
            assert abs(device.motor.torque) < 1e-6
