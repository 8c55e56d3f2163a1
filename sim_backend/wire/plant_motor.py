"""The motor of an emulated drive: the simulator's plant under the torque that the drive demands.

Every emulated drive uses this motor with its own demand law: impedance, current, or cascades. A law that depends on
measurements is evaluated every `BEAT`, as in firmware. A constant torque needs no repeated evaluation. Firmware
evaluates an impedance law at 10 kHz and more; here it is part of the plant's equations (`affine`), so that no gain is
too high for a beat. This assumes that such firmware extrapolates the angle by the time constant of its current loop,
and does not filter the speed; else a high kp without kd would swing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Generic, Protocol, Self, TypeVar

from sim_backend.fault_plan import FaultPlan
from sim_backend.integrator import CEILING, CLOCK, DAMPING, STATE, STIFFNESS, TIME, integrate, start
from sim_backend.parameters import SimParameters
from sim_backend.plant import (
    HOUSING,
    JOINT,
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
"""s between two evaluations of a demand law that depends on measurements."""
MOST_HEAT = 1e4
"""W in the winding at the largest current of an output stage: more than any drive here can supply."""
_RESTING = 1e-9
"""rad/s and N m: with less speed and torque than this, a motor is at rest."""


def limited(wanted: float, most: float) -> float:
    """Return `wanted` limited to the magnitude `most`, both in the same unit; 0 if either is NaN or `wanted` infinite.

    Python's min and max turn NaN into the limit, which would be the full torque.
    """
    return max(-most, min(most, wanted)) if math.isfinite(wanted) and most >= 0.0 else 0.0


class DemandLaw(Protocol):
    """The part of a drive's firmware that computes the torque demanded of its current loop."""

    def beats(self, enabled: bool) -> bool:
        """Return whether the law must be evaluated every `BEAT`, because the torque depends on measurements."""

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque that an enabled motor must make until the next evaluation, N m."""

    def at_rest(self, motor: PlantMotor[Any]) -> Self:
        """Return the law to use after the motor is enabled or disabled: without set-point and with zero integral."""


Law = TypeVar("Law", bound=DemandLaw)


class PlantMotor(Generic[Law]):
    """A plant whose motor follows a demand law. Times are s since the object was made. All quantities are at the
    motor's output shaft.

    note: a function that is called after each step with the time, s, and the torque in the coupling, N m. commanded:
    the torque demanded in the last step, N m; 0 while disabled. observer: a function that is called after each step,
    and when the motor is enabled or disabled. pulled: a function that returns the angle, rad, by which the locks of
    other joints turn this motor.
    """

    def __init__(self, parameters: SimParameters, law: Law, note: Callable[[float, float], None] | None = None) -> None:
        plant = constants(parameters)
        self.law = law
        self.enabled = False
        self.commanded = 0.0
        self.observer: Callable[[], None] = lambda: None
        self.pulled: Callable[[], float] = lambda: 0.0
        self.inertia = plant.inertia
        self._most = math.sqrt(MOST_HEAT / plant.heating)
        self._lag = 1.0 / plant.current_rate
        self._note = note
        self._faults = DriveFaults(FaultPlan())
        self._constants = packed(plant)
        self._path = start(plant)
        # no time passes; the machine code is there before the first request comes
        integrate(self._path, 0.0, 0.0, self._constants)

    @property
    def time(self) -> float:
        """The time up to which the motor is simulated, s."""
        return float(self._path[CLOCK, TIME])

    @property
    def position(self) -> float:
        """The angle as the drive's encoder measures it, rad."""
        return self._faults.angle(float(self._path[STATE, MOTOR]) + self.pulled(), self.time)

    @property
    def joint(self) -> float:
        """The angle of the locked joint, rad."""
        return float(self._path[STATE, JOINT])

    @property
    def velocity(self) -> float:
        """The speed after the drive's velocity filter, rad/s."""
        return self._faults.speed(float(self._path[STATE, VELOCITY]), self.time)

    @property
    def rate(self) -> float:
        """The true speed, rad/s."""
        return float(self._path[STATE, MOTOR_RATE])

    @property
    def torque(self) -> float:
        """The motor torque that the current makes, N m."""
        return float(self._path[STATE, TORQUE])

    @property
    def demand(self) -> float:
        """The torque that is demanded of the current loop now, N m; 0 while disabled, or if the law's result is not
        finite. Reading it advances the integral of a law that has one.
        """
        return limited(self.law.demand(self), self._most) if self.enabled else 0.0

    @property
    def temperature(self) -> float:
        """The temperature of the housing as the drive measures it, degC."""
        return self._faults.temperature(float(self._path[STATE, HOUSING]), self.time)

    @property
    def watchdog_broken(self) -> bool:
        """Return whether a fault keeps the drive's watchdog from acting."""
        return self._faults.watchdog_broken(self.time)

    def follow_plan(self, plan: FaultPlan) -> frozenset[str]:
        """Add the faults of `plan`, whose times are s since the object was made. Return the kinds of faults that the
        motor can have.
        """
        self._faults = DriveFaults(plan)
        return DriveFaults.KNOWN

    @property
    def coupling_torque(self) -> float:
        """The torque in the coupling, sigma_c, N m."""
        return float(coupling_torque(self._path[STATE], self._constants))

    def warm_to(self, temperature: float) -> None:
        """Set the temperature of winding and housing to `temperature`, degC."""
        self._path[STATE, HOUSING - 1] = self._path[STATE, HOUSING] = temperature

    def follow(self, law: Law) -> None:
        """Set the demand law."""
        self.law = law

    def enable(self) -> None:
        """Switch the output stage on, so that current can flow."""
        self.law = self.law.at_rest(self)
        self.enabled = True
        self.observer()

    def disable(self) -> None:
        """Switch the output stage off, so that no current flows. If a fault keeps the output stage on, the torque
        stays.
        """
        self.law = self.law.at_rest(self)
        self.enabled = False
        if self._faults.stays_on(self.time):
            self.observer()
            return
        self.commanded = 0.0
        self._path[STATE, TORQUE] = 0.0
        self.observer()

    def run(self, until: float) -> None:
        """Simulate the plant up to `until`, s. Has no effect if this time has passed."""
        while self.time < until:
            end = until
            if self.enabled or not self._faults.stays_on(self.time):
                self.commanded = self.demand
            if self.law.beats(self.enabled) and not self._rests:
                end = min((math.floor(self.time / BEAT + 1e-6) + 1.0) * BEAT, until)
            integrate(self._path, self._within_steps(), end, self._constants)
            self.observer()
            if self._note is not None:
                self._note(self.time, self.coupling_torque)

    def _within_steps(self) -> float:
        """Hand the demand law to the integrator if it is affine; else its torque until the next beat. Return the torque
        demanded at angle and rate zero, N m.
        """
        affine = getattr(self.law, "affine", None) if self.enabled and not self._faults.of_encoder else None
        gains = self._path[CLOCK]
        if affine is None or not all(map(math.isfinite, affine[:3])):
            gains[STIFFNESS] = gains[DAMPING] = 0.0
            return self.commanded
        torque, gains[STIFFNESS], damping, ceiling = affine
        gains[DAMPING] = damping + gains[STIFFNESS] * self._lag
        gains[CEILING] = limited(self._most, ceiling)
        return float(torque)

    @property
    def _rests(self) -> bool:
        """Return whether the motor does not move and no torque is demanded, so that simulating further would change
        nothing.
        """
        return self.commanded == 0.0 and max(abs(self.rate), abs(self.torque)) < _RESTING
