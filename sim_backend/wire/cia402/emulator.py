"""Emulated CiA 402 drives on a CAN bus, as `hil emulate cia402` serves them."""

from __future__ import annotations

from sim_backend.parameters import SimParameters
from sim_backend.wire.canbus.serve import CanFamily
from sim_backend.wire.cia402.device import Cia402Device
from sim_backend.wire.cia402.tables import MODELS


def _drive(model: str, ident: int, parameters: SimParameters | None, now: float) -> Cia402Device:
    if not 1 <= ident <= 127:
        raise ValueError(f"node id {ident} is not 1 to 127")
    return Cia402Device(model, ident, parameters=parameters, now=now, serial=0x62004410 + ident)


serve = CanFamily("CiA 402 drive", tuple(MODELS), "epos4", _drive)
