"""[winding] of the stand file: a model of the winding's temperature while the rotor is locked.

A locked rotor turns all its electric power into heat: P = R i^2. The heat flows from the winding to the case, and from
the case to the air. The model has two heat capacities and two thermal resistances, as data sheets state them:

    C1 dT1/dt = P - (T1 - T2)/R1        C2 dT2/dt = (T1 - T2)/R1 - (T2 - Ta)/R2

T1 winding, T2 case, Ta air, degC; R1, R2 K/W; C1 = tau1/R1, C2 = tau2/R2 J/K. Copper's resistance grows with T1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple, Self

from annotated_types import Unit
from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_COPPER = 0.00393  # 1/K, of the resistance at `_REFERENCE`; IEC 60028
_REFERENCE = 20.0  # degC
_NAMEPLATE = (
    "torque_constant",
    "resistance",
    "thermal_resistance",
    "time_constant",
    "case_thermal_resistance",
    "case_time_constant",
)
_MEASURED = ("continuous_torque", "peak_torque", "peak_time")
_SINK = (1e-6, 1e9)  # K/W, J/K of a case that stays at the air's temperature


class WindingTable(BaseModel):
    """[winding]: either the data sheet's six numbers or two measured points. All torques are at the motor shaft.

    torque_constant: N m/A. resistance: ohm at 20 degC. thermal_resistance: from winding to case, K/W. time_constant: of
    the winding, s. case_thermal_resistance: from case to air, K/W. case_time_constant: of the motor, s.
    continuous_torque: torque, N m, that heats the winding to limits.temperature after a long time. peak_torque: torque,
    N m, that heats a cold winding to limits.temperature in peak_time. peak_time: s. air: temperature of the air, degC.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    torque_constant: Annotated[Positive, Unit("N*m/A")] | None = None
    resistance: Annotated[Positive, Unit("ohm")] | None = None
    thermal_resistance: Annotated[Positive, Unit("K/W")] | None = None
    time_constant: Annotated[Positive, Unit("s")] | None = None
    case_thermal_resistance: Annotated[Positive, Unit("K/W")] | None = None
    case_time_constant: Annotated[Positive, Unit("s")] | None = None
    continuous_torque: Annotated[Positive, Unit("N*m")] | None = None
    peak_torque: Annotated[Positive, Unit("N*m")] | None = None
    peak_time: Annotated[Positive, Unit("s")] | None = None
    air: Annotated[float, Field(ge=-40.0, le=80.0), Unit("degC")] = 25.0

    @model_validator(mode="after")
    def _either(self) -> Self:
        given = {name for name in (*_NAMEPLATE, *_MEASURED) if getattr(self, name) is not None}
        if given not in (set(_NAMEPLATE), set(_MEASURED)):
            raise ValueError(
                f"give either {', '.join(_NAMEPLATE)} of the data sheet, or the measured {', '.join(_MEASURED)}"
            )
        if self.peak_torque is not None and self.peak_torque <= (self.continuous_torque or 0.0):
            raise ValueError(
                f"winding.peak_torque {self.peak_torque:g} N m is not above winding.continuous_torque "
                f"{self.continuous_torque:g} N m, which never heats it beyond its limit"
            )
        return self

    def model(self, limit: float) -> WindingModel:
        """Return the thermal model. limit: the temperature of the winding, degC, that both measured points reach."""
        if self.continuous_torque is not None and self.peak_torque is not None and self.peak_time is not None:
            share = (self.continuous_torque / self.peak_torque) ** 2
            tau = -self.peak_time / math.log1p(-share)
            per_square = max(limit - self.air, 1.0) / self.continuous_torque**2
            return WindingModel(per_square, 0.0, (1.0, tau), _SINK, self.air)
        kt, ohm, r1, tau1, r2, tau2 = (float(getattr(self, name)) for name in _NAMEPLATE)
        return WindingModel(ohm / kt**2, _COPPER, (r1, tau1 / r1), (r2, tau2 / r2), self.air)


class Temperatures(NamedTuple):
    """The temperatures of winding and case, degC."""

    winding: float
    case: float


@dataclass(frozen=True, slots=True)
class WindingModel:
    """The thermal model with two heat capacities: winding and case.

    heat: power for a square torque of 1 (N m)^2 at 20 degC, W/(N m)^2. copper: relative growth of the resistance, 1/K.
    winding, case: thermal resistance, K/W, and heat capacity, J/K, of each. air: degC.
    """

    heat: float
    copper: float
    winding: tuple[float, float]
    case: tuple[float, float]
    air: float

    @property
    def cold(self) -> Temperatures:
        """The temperatures after a long rest: winding and case are as warm as the air."""
        return Temperatures(self.air, self.air)

    def after(self, state: Temperatures, square: float, seconds: float) -> Temperatures:
        """Return the temperatures `seconds` s after `state`, under a mean square torque of `square` (N m)^2.

        The solution is exact for constant power. The power is computed with the resistance at the beginning: keep
        `seconds` below a tenth of the winding's time constant while the torque is on.
        """
        (r1, c1), (r2, c2) = self.winding, self.case
        power = self.heat * square * (1.0 + self.copper * (state.winding - _REFERENCE))
        end = (self.air + power * (r1 + r2), self.air + power * r2)
        a, b, c = 1.0 / (r1 * c1), 1.0 / (r1 * c2), 1.0 / (r2 * c2)
        mean, half = -0.5 * (a + b + c), math.sqrt(0.25 * (a - b - c) ** 2 + a * b)
        slow, fast = math.exp((mean + half) * seconds), math.exp((mean - half) * seconds)
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / half
        x, y = state.winding - end[0], state.case - end[1]
        return Temperatures(
            end[0] + even * x + odd * ((-a - mean) * x + a * y),
            end[1] + even * y + odd * (b * x + (-b - c - mean) * y),
        )
