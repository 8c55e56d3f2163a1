"""Emulated CubeMars AK and Damiao motors on a CAN bus, as `hil emulate mit` serves them."""

from __future__ import annotations

from sim_backend.parameters import SimParameters
from sim_backend.wire.canbus.serve import CanFamily
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.mit.tables import MODELS


def _motor(model: str, ident: int, parameters: SimParameters | None, now: float) -> MitDevice:
    return MitDevice(model, ident, parameters=parameters, now=now)


serve = CanFamily("motor", tuple(sorted(MODELS)), "dm-j4310", _motor)
