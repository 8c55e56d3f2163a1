"""The profiles of CiA 402 drives and the texts of their error codes. They are read from table.toml."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import BaseModel, ConfigDict

from drivers.servo import DeviceFault
from drivers.tables import table

RESTARTED = -1
"""Fault code of this project: the drive restarted during the run."""
NOT_ENABLED = -2
"""Fault code of this project: the drive left the state OPERATION ENABLED during the run."""
HEARTBEAT_LOST = 0x8130


class ObjectIndex(NamedTuple):
    """Index and sub-index of an object in a drive's object dictionary."""

    object: int
    sub: int

    def __str__(self) -> str:
        return f"0x{self.object:04X}:{self.sub:02d}"


class Profile(BaseModel):
    """One kind of CiA 402 drive: the indexes of its objects (None: it lacks the object). A field `..._unit` is the SI
    value of one count.

    per_mille: whether set-point and torque are in thousandths of the rated torque; otherwise they are in mA.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    explanation: str
    mode: int
    target: ObjectIndex
    torque: ObjectIndex
    per_mille: bool
    resolution: ObjectIndex
    error_code: ObjectIndex
    abort_option: ObjectIndex
    speed_limit: ObjectIndex
    resolution_factor: int = 1
    vendor: int | None = None
    speed_limit_unit: float | None = None
    """rad/s in one count of the speed limit; None: the same as one count of velocity."""
    velocity_unit: ObjectIndex | None = None
    rated_torque: ObjectIndex | None = None
    rated_torque_unit: float = 1e-3
    torque_constant: ObjectIndex | None = None
    torque_constant_unit: float = 1.0
    torque_limit: ObjectIndex | None = None
    current_limit: ObjectIndex | None = None
    current_limit_unit: float = 1.0
    temperature_limit: ObjectIndex | None = None
    temperature: ObjectIndex | None = None
    temperature_unit: float = 1.0
    voltage: ObjectIndex | None = None
    voltage_unit: float = 1.0
    abort_option_may_be_missing: bool = False


def profile(name: str) -> Profile:
    """Return the profile `name`. Raises KeyError if there is none."""
    return Profile.model_validate(table("cia402")["profiles"][name])


def fault(code: int) -> DeviceFault:
    """Return the error for the drive's error `code`."""
    texts = {int(key, 0): text for key, text in table("cia402")["errors"].items()}
    if code == RESTARTED:
        return DeviceFault(code, "the drive restarted during the run: check its supply")
    if code == NOT_ENABLED:
        return DeviceFault(
            code,
            "the drive left operation enabled by itself: another program commands it, its enable input fell, or "
            "its supply failed",
        )
    text = texts.get(code, "look the code up in the vendor's firmware specification")
    return DeviceFault(code, f"the drive reports error 0x{code:04X}: {text}")
