"""The motor of an emulated drive: the simulator's plant, carried in time under the torque that the drive demands.

Every emulated drive uses this one motor and gives it a demand law of its own: impedance, current, cascades. A law that
depends on what the drive measures is evaluated every `BEAT`, as firmware does; a constant torque needs no beat.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Generic, Protocol, Self, TypeVar

from sim_backend.fault_plan import FaultPlan
from sim_backend.integrator import CLOCK, STATE, TIME, integrate, start
from sim_backend.parameters import SimParameters
from sim_backend.plant import (
    HOUSING,
    MOTOR,
    MOTOR_RATE,
    TORQUE,
    VELOCITY,
    constants,
    coupling_torque,
    packed,
)
from sim_backend.wire.drive_faults import DriveFaults

BEAT = 1e-3
"""s between two evaluations of a demand law."""
_RESTING = 1e-9
"""rad/s and N m below which a motor rests."""


class DemandLaw(Protocol):
    """The part of a drive's firmware that demands torque of its current loop."""

    def beats(self, enabled: bool) -> bool:
        """Return whether time passes in steps of `BEAT`: the demand depends on what is measured."""

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque demanded of an enabled motor until the next beat, N m."""

    def at_rest(self, motor: PlantMotor[Any]) -> Self:
        """Return the law that holds after the motor is enabled or disabled: no set-point, no integral."""


Law = TypeVar("Law", bound=DemandLaw)


class PlantMotor(Generic[Law]):
    """A plant under a demand law. Times are s since it was made; everything is at the motor's output shaft.

    note: called after each step with the time, s, and the torque in the coupling, N m. commanded: the torque demanded
    in the last step, N m, 0 while disabled. observer: called after each step, and when the motor is enabled or
    disabled.
    """

    def __init__(self, parameters: SimParameters, law: Law, note: Callable[[float, float], None] | None = None) -> None:
        plant = constants(parameters)
        self.law = law
        self.enabled = False
        self.commanded = 0.0
        self.observer: Callable[[], None] = lambda: None
        self.inertia = plant.inertia
        self._note = note
        self._faults = DriveFaults(FaultPlan())
        self._constants = packed(plant)
        self._path = start(plant)
        # no time passes; the machine code is there before the first request comes
        integrate(self._path, 0.0, 0.0, self._constants)

    @property
    def time(self) -> float:
        """The time it has been carried to, s."""
        return float(self._path[CLOCK, TIME])

    @property
    def position(self) -> float:
        """The angle as the drive's encoder measures it, rad."""
        return self._faults.angle(float(self._path[STATE, MOTOR]), self.time)

    @property
    def velocity(self) -> float:
        """The speed as the drive filters it, rad/s."""
        return self._faults.speed(float(self._path[STATE, VELOCITY]), self.time)

    @property
    def rate(self) -> float:
        """The speed, rad/s."""
        return float(self._path[STATE, MOTOR_RATE])

    @property
    def torque(self) -> float:
        """The torque that the current makes, N m."""
        return float(self._path[STATE, TORQUE])

    @property
    def demand(self) -> float:
        """The torque demanded of the current loop now, N m; 0 while disabled. A law with an integral advances it."""
        return self.law.demand(self) if self.enabled else 0.0

    @property
    def temperature(self) -> float:
        """The temperature of the housing as the drive measures it, degC."""
        return self._faults.temperature(float(self._path[STATE, HOUSING]), self.time)

    @property
    def watchdog_broken(self) -> bool:
        """Return whether a fault keeps the drive's watchdog from acting."""
        return self._faults.watchdog_broken(self.time)

    def follow_plan(self, plan: FaultPlan) -> frozenset[str]:
        """Let the faults of `plan` happen, whose times are s since it was made; return the kinds that it knows."""
        self._faults = DriveFaults(plan)
        return DriveFaults.KNOWN

    @property
    def coupling_torque(self) -> float:
        """The torque in the coupling, sigma_c, N m."""
        return float(coupling_torque(self._path[STATE], self._constants))

    def warm_to(self, temperature: float) -> None:
        """Heat winding and housing to `temperature` degC at once."""
        self._path[STATE, HOUSING - 1] = self._path[STATE, HOUSING] = temperature

    def follow(self, law: Law) -> None:
        """Replace the demand law."""
        self.law = law

    def enable(self) -> None:
        """Let current flow."""
        self.law = self.law.at_rest(self)
        self.enabled = True
        self.observer()

    def disable(self) -> None:
        """Open the output stage: no current from now on. One that a fault keeps closed keeps its torque."""
        self.law = self.law.at_rest(self)
        self.enabled = False
        if self._faults.stays_on(self.time):
            self.observer()
            return
        self.commanded = 0.0
        self._path[STATE, TORQUE] = 0.0
        self.observer()

    def run(self, until: float) -> None:
        """Carry the plant to `until`, s; nothing happens where that is past."""
        while self.time < until:
            end = until
            if self.enabled or not self._faults.stays_on(self.time):
                self.commanded = self.demand
            if self.law.beats(self.enabled) and not self._rests:
                end = min((math.floor(self.time / BEAT + 1e-6) + 1.0) * BEAT, until)
            integrate(self._path, self.commanded, end, self._constants)
            self.observer()
            if self._note is not None:
                self._note(self.time, self.coupling_torque)

    @property
    def _rests(self) -> bool:
        """Whether nothing moves and nothing is demanded, so that the next beats would change nothing."""
        return self.commanded == 0.0 and max(abs(self.rate), abs(self.torque)) < _RESTING
