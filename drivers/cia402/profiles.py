"""What kinds of CiA 402 drive there are, and what their error codes mean: data in tables/cia402.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict

from drivers.servo import DeviceFault

RESTARTED = -1
"""The code of a fault that the drive has no code for: it was restarted in the run."""
NOT_ENABLED = -2
"""The code of a fault that the drive has no code for: it left the state it was armed into."""
HEARTBEAT_LOST = 0x8130


class Place(NamedTuple):
    """Where an object is in the dictionary: its index and sub-index."""

    object: int
    sub: int

    def __str__(self) -> str:
        return f"0x{self.object:04X}:{self.sub:02d}"


class Profile(BaseModel):
    """One kind of drive: where its objects are. None: it has no such object. The `_unit`s are SI of one count.

    per_mille: set-point and torque are thousandths of the rated torque; otherwise they are mA.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    explanation: str
    mode: int
    target: Place
    torque: Place
    per_mille: bool
    resolution: Place
    error_code: Place
    abort_option: Place
    speed_limit: Place
    resolution_factor: int = 1
    vendor: int | None = None
    speed_limit_unit: float | None = None
    """rad/s; None: that of velocity."""
    velocity_unit: Place | None = None
    rated_torque: Place | None = None
    rated_torque_unit: float = 1e-3
    torque_constant: Place | None = None
    torque_constant_unit: float = 1.0
    torque_limit: Place | None = None
    current_limit: Place | None = None
    current_limit_unit: float = 1.0
    temperature_limit: Place | None = None
    temperature: Place | None = None
    temperature_unit: float = 1.0
    voltage: Place | None = None
    voltage_unit: float = 1.0
    abort_option_may_be_missing: bool = False


@cache
def _table() -> Mapping[str, Any]:
    return tomllib.loads(files("drivers").joinpath("cia402/table.toml").read_text(encoding="utf-8"))


def profile(name: str) -> Profile:
    """The profile `name`. Raises KeyError where there is none."""
    return Profile.model_validate(_table()["profiles"][name])


def profile_names() -> list[str]:
    """The profiles there are."""
    return list(_table()["profiles"])


def fault(code: int) -> DeviceFault:
    """The fault with the drive's error `code`, in words."""
    texts = {int(key, 0): text for key, text in _table()["errors"].items()}
    if code == RESTARTED:
        return DeviceFault(code, "the drive was restarted in the run: check its supply")
    if code == NOT_ENABLED:
        return DeviceFault(
            code,
            "the drive left operation enabled by itself: somebody else on the bus commands it, its enable input fell, "
            "or its supply failed",
        )
    text = texts.get(code, "look the code up in the vendor's firmware specification")
    return DeviceFault(code, f"the drive reports error 0x{code:04X}: {text}")
