"""The [dynamixel] table of stand.toml."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self, get_args

from annotated_types import Ge, Gt, Le, Unit
from pydantic import BeforeValidator

from drivers.dynamixel.models import DynamixelModel, models, no_current
from drivers.gate import watchdog_problem
from drivers.servo import Quantity
from drivers.torque_constant import contradiction


def _known(name: object) -> object:
    """Return `name`. Raises ValueError with the reason for a servo that measures no current."""
    if isinstance(name, str) and name not in models() and (reason := no_current(name)):
        raise ValueError(reason)
    return name


if TYPE_CHECKING:
    ModelName = str
else:  # so that a refused name is reported with all that are known
    ModelName = Annotated[Literal[tuple(sorted(models()))], BeforeValidator(_known)]

Mode = Literal["current", "extended-position", "current-based-position"]
Baudrate = Literal[9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000]
"""bit/s that both the servos and dynamixel-sdk support. dynamixel-sdk does not support 4.5 Mbaud."""


@dataclass(frozen=True, slots=True)
class DynamixelConfig:
    """The [dynamixel] table of stand.toml. Raises ValueError if model and mode do not fit each other.

    port: the serial port. model: the type of the servo. mode: the operating mode; None: current if the model
    measures current. torque_constant: N m/A at the horn; None: an estimate from the model's stall points. sign: 1 if
    the servo's positive direction is the stand's, else -1. return_delay: s from request to reply. watchdog: s without a
    request after which the servo stops by itself, in steps of 20 ms; 0: never. reply_timeout: s that a reply may take
    beyond its time on the wire.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    port: str
    model: ModelName
    id: Annotated[int, Ge(0), Le(252)] = 1
    baudrate: Baudrate = 1_000_000
    mode: Mode | None = None
    torque_constant: Annotated[float, Gt(0), Unit("N*m/A")] | None = None
    sign: Literal[1, -1] = 1
    return_delay: Annotated[float, Ge(0), Le(508e-6), Unit("s")] = 0.0
    watchdog: Annotated[float, Ge(0), Le(2.54), Unit("s")] = 0.1
    reply_timeout: Annotated[float, Gt(0), Le(0.5), Unit("s")] = 0.008

    def __post_init__(self) -> None:
        wrong = list(self._misfits())
        if wrong:
            raise ValueError("; ".join(wrong))

    def _misfits(self) -> Iterator[str]:
        if self.baudrate not in get_args(Baudrate):
            yield f"dynamixel.baudrate {self.baudrate}: one of {', '.join(map(str, get_args(Baudrate)))}"
        if self.model not in models():
            known = f"dynamixel.model {self.model!r} is not known; there are {', '.join(sorted(models()))}"
            yield no_current(self.model) or known
        else:
            yield from self._misfits_of(models()[self.model])
        if problem := watchdog_problem("dynamixel", self.watchdog, self.reply_timeout):
            yield problem

    def _misfits_of(self, model: DynamixelModel) -> Iterator[str]:
        if not model.current_lsb and self.effective_mode != "extended-position":
            yield f"dynamixel.mode {self.mode!r}: the {model.name} has no current control"
        source = f"the maker's stall points of the {model.name}"
        if problem := contradiction("dynamixel.torque_constant", self.torque_constant, model.torque_constant, source):
            yield problem
        if model.protocol == 2:
            return
        if self.mode == "current-based-position":
            yield f"dynamixel.mode {self.mode!r}: the {model.name} has current and extended-position"
        if self.baudrate in {2_000_000, 4_000_000}:
            yield f"dynamixel.baudrate {self.baudrate}: the {model.name} has no code for it; use 1000000 or 3000000"
        if self.watchdog:
            yield (
                f"dynamixel.watchdog {self.watchdog} s: the {model.name} has none: set it to 0; the motor then stays "
                "live when this computer stops"
            )

    @property
    def largest_torque(self) -> float:
        """The most torque, N m, that the specification states at stall; infinite where it states none."""
        return max((torque for _, _, torque in models()[self.model].stall), default=math.inf)

    def for_quantity(self, quantity: Quantity) -> Self:
        """Return the configuration that commands `quantity`. For positions, choose the mode that limits the torque if
        the model has it.

        Raises ValueError if the stated mode commands the other quantity, or if no mode of the model commands
        `quantity`.
        """
        current = bool(models()[self.model].current_lsb)
        if self.mode is not None:
            if (self.mode == "current") != (quantity is Quantity.TORQUE):
                raise ValueError(f"dynamixel.mode = {self.mode!r} does not command {quantity}: remove it")
            return self
        if quantity is Quantity.TORQUE:
            if not current:
                raise ValueError(f"the {self.model} has no current control: use --mode position")
            return replace(self, mode="current")
        limited = current and models()[self.model].protocol == 2
        return replace(self, mode="current-based-position" if limited else "extended-position")

    @property
    def effective_mode(self) -> Mode:
        """The operating mode: `mode`, or the mode that the model implies if `mode` is None."""
        if self.mode is not None:
            return self.mode
        return "current" if models()[self.model].current_lsb else "extended-position"
