"""The emulated controller against the vendor's own client, over python-can."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from sim_backend.wire.can_families import moteus as serve

moteus: Any = pytest.importorskip("moteus")


def test_the_vendors_client_stops_drives_queries_and_configures_it() -> None:
    async def session() -> None:
        transport = moteus.PythonCan(interface="virtual", channel="test_moteus_client")
        controller = moteus.Controller(id=1, transport=transport)
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
        transport.close()

    with serve("test_moteus_client", interface="virtual"):
        asyncio.run(asyncio.wait_for(session(), 30.0))
