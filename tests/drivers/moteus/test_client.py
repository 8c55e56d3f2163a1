"""The emulated controller against the vendor's own client and tool."""

from __future__ import annotations

import asyncio
import json
import math
import subprocess
import sys
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

import pytest

from sim_backend.wire.can_families import moteus as serve
from sim_backend.wire.moteus.device import STOPPED

pytestmark = pytest.mark.study
Talk = Callable[[Any, Any], Coroutine[Any, Any, None]]


@pytest.fixture
def moteus() -> Any:
    return pytest.importorskip("moteus")


def session(moteus: Any, channel: str, talk: Talk) -> None:
    async def talks() -> None:
        transport = moteus.PythonCan(interface="virtual", channel=channel)
        await talk(moteus, moteus.Controller(id=1, transport=transport))
        transport.close()

    with serve(channel, interface="virtual"):
        asyncio.run(asyncio.wait_for(talks(), 30.0))


async def drives_queries_and_configures(moteus: Any, controller: Any) -> None:
    register = moteus.Register
    assert (await controller.set_stop(query=True)).values[register.MODE] == moteus.Mode.STOPPED
    for _ in range(5):
        result = await controller.set_position(
            position=math.nan,
            feedforward_torque=0.2,
            kp_scale=0.0,
            kd_scale=0.0,
            maximum_torque=0.5,
            watchdog_timeout=5.0,
            query=True,
        )
    assert result.values[register.MODE] == moteus.Mode.POSITION
    assert result.values[register.TORQUE] == pytest.approx(0.2, abs=0.02)
    asked = {register.MODEL_NUMBER: moteus.INT32, register.FIRMWARE_VERSION: moteus.INT32}
    assert (await controller.custom_query(asked)).values[register.FIRMWARE_VERSION] == 0x010100
    stream = moteus.Stream(controller)
    assert await stream.command(b"conf get servo.timeout_mode", allow_any_response=True) == b"12"
    await stream.command(b"conf set servo.timeout_mode 0")
    assert b"servo.timeout_mode 0\n" in await stream.command(b"conf enumerate")
    await controller.set_stop()
    assert (await controller.query()).values[register.MODE] == moteus.Mode.STOPPED


async def uses_every_mode(moteus: Any, controller: Any) -> None:
    mode = moteus.Mode

    async def reached(command: Any, **options: Any) -> Any:
        await controller.set_stop()
        for _ in range(5):
            result = await command(query=True, **options)
        return result.values[moteus.Register.MODE]

    assert await reached(controller.set_current, d_A=0.0, q_A=1.0) == mode.CURRENT
    assert await reached(controller.set_zero_velocity) == mode.ZERO_VELOCITY
    assert await reached(controller.set_brake) == mode.BRAKE
    within = {"lower_bound": -0.5, "upper_bound": 0.5, "watchdog_timeout": 5.0}
    assert await reached(controller.set_stay_within, **within) == mode.STAY_WITHIN
    assert await reached(controller.set_vfoc, theta=0.0, voltage=0.1) == mode.FAULT
    await controller.set_stop()


def test_the_vendors_client_stops_drives_queries_and_configures_it(moteus: Any) -> None:
    session(moteus, "test_moteus_client", drives_queries_and_configures)


def test_the_vendors_client_uses_every_mode(moteus: Any) -> None:
    session(moteus, "test_moteus_modes", uses_every_mode)


@pytest.mark.usefixtures("moteus")
def test_the_vendors_tool_shows_what_it_is_and_its_channels_and_sets_the_zero(link: Path) -> None:
    info = json.loads(tool(link, "--info"))
    assert info["git_hash"] == "0" * 40
    assert json.loads(tool(link, "--read", "firmware"))["version"] == 0x010100
    assert json.loads(tool(link, "--read", "servo_stats"))["mode"] == STOPPED
    tool(link, "--zero-offset")
    assert abs(json.loads(tool(link, "--read", "servo_stats"))["position"]) < 1e-3


@pytest.fixture
def link(tmp_path: Path) -> Iterator[Path]:
    with serve(tmp_path / "ttyCAN"):
        yield tmp_path / "ttyCAN"


def tool(link: Path, *arguments: str) -> str:
    """Run the vendor's moteus_tool in a process of its own."""
    bus = ["--force-transport", "pythoncan", "--can-iface", "slcan", "--can-chan", str(link)]
    command = [sys.executable, "-m", "moteus.moteus_tool", *bus, "-t", "1", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
