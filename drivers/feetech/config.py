"""The [feetech] table of stand.toml."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self, get_args

from annotated_types import Ge, Gt, Le, Unit

from drivers.feetech.models import CURRENT_LSB, FeetechModel, models
from drivers.servo import Quantity
from drivers.torque_constant import contradiction, implausible_stall

if TYPE_CHECKING:
    ModelName = str
else:
    ModelName = Literal[tuple(sorted(models()))]  # so that a refused name is reported with all that are known

Mode = Literal["torque", "position"]
Baudrate = Literal[1000000, 500000, 250000, 128000, 115200, 76800, 57600, 38400]
"""bit/s, in the order of the values 0, 1, 2 ... of the register Baud Rate(6)."""

_CELL = 'put a torque cell at the joint ([joint_sensor] and torque_source = "joint"), and record with --mode position'


@dataclass(frozen=True, slots=True)
class FeetechConfig:
    """The [feetech] table of stand.toml. Raises ValueError if model and mode do not fit each other.

    port: the serial port. model: the type of the servo. id: id of the servo; a new servo has 1. baudrate: bit/s;
    a new servo has 1000000. mode: "position", or "torque" with an HLS; None: as the recording commands.
    torque_constant: N m/A at the output shaft; None: an estimate for an HLS, no torque for an STS. sign: 1 if the
    servo's positive direction is the stand's, else -1. return_delay: s from request to reply. reply_timeout: s that a
    reply may take beyond its time on the wire.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    port: str
    model: ModelName
    id: Annotated[int, Ge(0), Le(253)] = 1
    baudrate: Baudrate = 1_000_000
    mode: Mode | None = None
    torque_constant: Annotated[float, Gt(0), Unit("N*m/A")] | None = None
    sign: Literal[1, -1] = 1
    return_delay: Annotated[float, Ge(0), Le(508e-6), Unit("s")] = 0.0
    reply_timeout: Annotated[float, Gt(0), Le(0.5), Unit("s")] = 0.008

    def __post_init__(self) -> None:
        wrong = list(self._misfits())
        if wrong:
            raise ValueError("; ".join(wrong))

    @property
    def largest_torque(self) -> float:
        """The stall torque, N m, of the strongest variant of the model."""
        return models()[self.model].stall

    @property
    def constant(self) -> float:
        """The torque constant, N m/A; 0 if the torque cannot be inferred from the current."""
        model = models()[self.model]
        return (self.torque_constant or model.torque_constant) if model.has_current else 0.0

    @property
    def effective_mode(self) -> Mode:
        """The operating mode: `mode`, or, if `mode` is None, torque for a model with a torque mode and position
        otherwise.
        """
        return self.mode or ("torque" if models()[self.model].has_torque_mode else "position")

    def for_quantity(self, quantity: Quantity) -> Self:
        """Return the configuration that commands `quantity`. Raises ValueError if the model or the stated `mode` cannot
        command it.
        """
        mode: Mode = "torque" if quantity is Quantity.TORQUE else "position"
        if mode == "torque" and not models()[self.model].has_torque_mode:
            raise ValueError(
                f"the {self.model} accepts no torque as set-point, only a position: {_CELL}; an HLS has a torque mode"
            )
        if self.mode not in {None, mode}:
            raise ValueError(f"feetech.mode = {self.mode!r} does not command {quantity}: remove it")
        return replace(self, mode=mode)

    def restrictions(self, torque_source: str) -> list[str]:
        """Return sentences about what the servo cannot do, with remedies. torque_source: the stand's source of torque,
        such as "motor".
        """
        return [self._torque_restriction(models()[self.model])] if torque_source == "motor" else []

    def _torque_restriction(self, model: FeetechModel) -> str:
        if not model.has_current:
            return f"the {model.name} measures no current, so no torque can be inferred: {_CELL}"
        if not self.constant:
            return (
                f"no torque is inferred from the current of the {model.name} without feetech.torque_constant, N m/A: "
                f"measure it, or {_CELL}"
            )
        return (
            f"torque is inferred from a current with counts of {CURRENT_LSB * self.constant * 1e3:.3g} mN m, behind a "
            "gearbox whose friction hides smaller torques, and Kc and Bc carry the uncertainty of its scale: for "
            f"better values {_CELL}"
        )

    def _misfits(self) -> Iterator[str]:
        if self.baudrate not in get_args(Baudrate):
            yield f"feetech.baudrate {self.baudrate}: one of {', '.join(map(str, get_args(Baudrate)))}"
        if self.model not in models():
            yield f"feetech.model {self.model!r} is not known; there are {', '.join(sorted(models()))}"
        else:
            yield from self._misfits_of(models()[self.model])

    def _misfits_of(self, model: FeetechModel) -> Iterator[str]:
        if self.mode == "torque" and not model.has_torque_mode:
            yield f"feetech.mode 'torque': the {model.name} has none, only position"
        if model.family == "hls" and self.return_delay:
            yield f"feetech.return_delay {self.return_delay} s: the {model.name} has none: set it to 0"
        if model.family == "hls" and not self.constant:
            yield f"feetech.torque_constant: must be given for the {model.name}, N m/A at its output shaft"
        if not model.has_current and self.torque_constant:
            yield f"feetech.torque_constant: the {model.name} measures no current: remove it"
        key, given = "feetech.torque_constant", self.torque_constant
        source = f"the maker's stall point of the {model.name}"
        problem = contradiction(key, given, model.torque_constant, source)
        if problem := problem or implausible_stall(key, given, model.stall, model.name):
            yield problem
