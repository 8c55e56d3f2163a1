"""Emulated ODrive axes on a CAN bus, as `hil emulate odrive` serves them."""

from __future__ import annotations

from sim_backend.parameters import SimParameters
from sim_backend.wire.canbus.serve import CanFamily
from sim_backend.wire.odrive.device import OdriveDevice

_FIRST_SERIAL = 0x3A5B12_000000


def _axis(firmware: str, ident: int, parameters: SimParameters | None, now: float) -> OdriveDevice:
    return OdriveDevice(ident, firmware=firmware, parameters=parameters, now=now, serial=_FIRST_SERIAL + ident)


serve = CanFamily("ODrive firmware", ("0.5.6", "0.6.10", "0.6.11"), "0.6.10", _axis, first=0)
