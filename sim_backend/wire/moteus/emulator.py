"""Emulated moteus controllers on a CAN FD bus, as `hil emulate moteus` serves them."""

from __future__ import annotations

from sim_backend.parameters import SimParameters
from sim_backend.wire.canbus.serve import CanFamily
from sim_backend.wire.moteus.device import MoteusDevice


def _controller(_model: str, ident: int, parameters: SimParameters | None, now: float) -> MoteusDevice:
    return MoteusDevice(ident, parameters=parameters, now=now)


serve = CanFamily("controller", ("moteus",), "moteus", _controller)
