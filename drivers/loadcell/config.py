"""The [joint_sensor] table of stand.toml, for a torque cell on a serial port."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Unit

LineFormat = Literal["micros,raw", "value"]


@dataclass(frozen=True, slots=True)
class LoadCellConfig:
    """The [joint_sensor] table of stand.toml with kind = "loadcell".

    port: the serial port. scale: N m for one count (format "micros,raw") or for a value of 1 (format "value").
    baudrate: bit/s. format: the content of a line; "micros,raw": the board's microseconds and the counts of a 24 bit
    converter, "value": one number. sign: 1 if the cell's positive direction is the joint's, else -1. tare: the value
    without torque, in counts or as printed; None: the median of the readings while the cell is opened. drift: N m by
    which the zero may differ from `tare`, or change while the cell is opened. delay: s from a measurement to the start
    of its line.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    port: str
    scale: Annotated[float, Gt(0)]
    baudrate: Annotated[int, Ge(1200), Le(4_000_000)] = 115200
    format: LineFormat = "micros,raw"
    sign: Literal[1, -1] = 1
    tare: float | None = None
    drift: Annotated[float, Gt(0), Unit("N*m")] = 1e-3
    delay: Annotated[float, Ge(0), Le(0.2), Unit("s")] = 0.0
