"""The channels of a recording: one table that defines the fields of a row, their storage and their descriptions; and
how well the scale of its torque is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, Self, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray


class Channel(NamedTuple):
    """The unit and the description of a channel."""

    unit: str
    description: str


class Row(NamedTuple):
    """One row of a recording, with a field for each channel. `Row(seq)` is a row without readings."""

    seq: Annotated[int, Channel("1", "row number since the start")]
    time: Annotated[float, Channel("s", "when the set-point was sent, from the start")] = math.nan
    command: Annotated[
        float,
        Channel(
            "N*m or rad",
            "set-point at the joint: torque or position, as the profile's mode says; of an import also current, A, or "
            "voltage, V",
        ),
    ] = math.nan
    torque: Annotated[
        float,
        Channel("N*m", "torque at the joint: the joint's cell, or the motor's torque times the gear ratio, as read"),
    ] = math.nan
    dtheta: Annotated[
        float,
        Channel("rad", "deflection: motor position over gear ratio, less the joint's, less their value at rest"),
    ] = math.nan
    dtheta_dot: Annotated[
        float, Channel("rad/s", "rate of the deflection as the drive reports it, late by its own filter")
    ] = math.nan
    motor_position: Annotated[float, Channel("rad", "at the motor shaft")] = math.nan
    motor_velocity: Annotated[float, Channel("rad/s", "at the motor shaft, as the drive reports it")] = math.nan
    motor_torque: Annotated[float, Channel("N*m", "at the motor shaft, as the drive reports it")] = math.nan
    joint_position: Annotated[float, Channel("rad", "at the locked joint")] = math.nan
    joint_torque: Annotated[float, Channel("N*m", "at the locked joint")] = math.nan
    read_time: Annotated[float, Channel("s", "midpoint of the bus read, from the start")] = math.nan
    joint_time: Annotated[
        float, Channel("s", "when the joint was read, where another device reads it, from the start")
    ] = math.nan
    temperature: Annotated[float, Channel("degC", "of the winding, as the drive reports it")] = math.nan
    status: Annotated[int, Channel("1", "bits: 1 no reply, 2 bad reply, 4 late, 8 saturated, 16 stale, 32 missed")] = 0


row_of: Callable[[tuple[float, ...]], Row] = partial(tuple.__new__, Row)
"""A function that returns a Row from the sequence of all its fields; five times as fast as `Row` with names."""

_FIELDS = {name: get_args(hint) for name, hint in get_type_hints(Row, include_extras=True).items()}

CHANNELS: Mapping[str, Channel] = MappingProxyType({name: channel for name, (_, channel) in _FIELDS.items()})
_COMMANDED = {"torque": "N*m", "position": "rad", "current": "A", "voltage": "V"}
ROW = np.dtype([(name, "<u8" if kind is int else "<f8") for name, (kind, _) in _FIELDS.items()])
LATER = frozenset({"joint_time"})
"""The channels that old recordings do not have; they are read as NaN."""
END_MARK = 2**64 - 1
"""The `seq` of a row in the file that is reserved but not written yet."""

Rows = NDArray[np.void]
LARGEST = 1e12
"""The largest value, SI, that is accepted as a reading of any channel; the square of a larger value could overflow."""


def units_of(mode: str) -> dict[str, str]:
    """Return the unit of each channel. The mode of the profile, torque or position, determines the unit of the
    command.
    """
    units = {name: channel.unit for name, channel in CHANNELS.items()}
    return units | {"command": _COMMANDED.get(mode, units["command"])}


@dataclass(frozen=True, slots=True)
class TorqueScale:
    """How well the scale of a torque is known.

    uncertainty: relative standard uncertainty, NaN if not known. source: in words, what states it; if it is not known,
    which drive or cell states none; "" if no drive was recorded.
    """

    uncertainty: float = math.nan
    source: str = ""

    @classmethod
    def stored(cls, attributes: Mapping[str, Any]) -> Self:
        """Return what a recording with these attributes says."""
        known, source = attributes.get("torque_uncertainty"), str(attributes.get("torque_scale", ""))
        return cls(known if isinstance(known, float) and 0.0 <= known < 1.0 else math.nan, source)

    @classmethod
    def widest(cls, scales: Iterable[Self]) -> Self:
        """Return the least well known of several scales; the first of those that are not known, if none is known."""
        return max(scales, key=lambda one: one.included, default=cls())

    @property
    def included(self) -> float:
        """Return the uncertainty that intervals include: 0 if it is not known."""
        return 0.0 if math.isnan(self.uncertainty) else self.uncertainty

    def attributes(self) -> dict[str, str | float]:
        """Return the attributes of a recording that say this."""
        return {"torque_uncertainty": self.uncertainty, "torque_scale": self.source}
