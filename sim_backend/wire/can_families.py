"""The families of emulated drives on a CAN bus, as `hil emulate` serves them."""

from __future__ import annotations

from sim_backend.parameters import SimParameters
from sim_backend.wire.canbus.serve import CanFamily
from sim_backend.wire.cia402 import tables as cia402_tables
from sim_backend.wire.cia402.device import Cia402Device
from sim_backend.wire.mit import tables as mit_tables
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.moteus.device import MoteusDevice
from sim_backend.wire.odrive.device import OdriveDevice
from sim_backend.wire.robstride import tables as robstride_tables
from sim_backend.wire.robstride.device import RobstrideDevice


def _axis(firmware: str, ident: int, parameters: SimParameters | None, now: float) -> OdriveDevice:
    return OdriveDevice(ident, firmware=firmware, parameters=parameters, now=now, serial=0x3A5B12_000000 + ident)


def _motor(model: str, ident: int, parameters: SimParameters | None, now: float) -> MitDevice:
    return MitDevice(model, ident, parameters=parameters, now=now)


def _actuator(model: str, ident: int, parameters: SimParameters | None, now: float) -> RobstrideDevice:
    return RobstrideDevice(model, ident, parameters=parameters, now=now, serial=0x3130_4D51_3230_0000 + ident)


def _controller(_model: str, ident: int, parameters: SimParameters | None, now: float) -> MoteusDevice:
    return MoteusDevice(ident, parameters=parameters, now=now)


def _drive(model: str, ident: int, parameters: SimParameters | None, now: float) -> Cia402Device:
    if not 1 <= ident <= 127:
        raise ValueError(f"node id {ident} is not 1 to 127")
    return Cia402Device(model, ident, parameters=parameters, now=now, serial=0x62004410 + ident)


odrive = CanFamily("ODrive firmware", ("0.5.6", "0.6.10", "0.6.11"), "0.6.10", _axis, first=0)
mit = CanFamily("motor", tuple(sorted(mit_tables.MODELS)), "dm-j4310", _motor)
robstride = CanFamily("RobStride motor", tuple(robstride_tables.MODELS), "rs00", _actuator)
moteus = CanFamily("controller", ("moteus",), "moteus", _controller)
cia402 = CanFamily("CiA 402 drive", tuple(cia402_tables.MODELS), "epos4", _drive)
