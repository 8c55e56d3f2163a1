"""A drive: its table in stand.toml, and the servo. In place of a protocol it computes a motor on a spring and a damper.

The motor has no mass, so that its velocity is v = (torque - stiffness * angle) / damping, all at the motor shaft.
"""

from dataclasses import dataclass
from math import exp
from typing import Annotated, ClassVar

from annotated_types import Gt

from drivers.clock import Clock, VirtualClock
from drivers.gate import Admitted, DriveServo, Gate
from drivers.servo import Limits, Quantity, Sample, ServoInfo


@dataclass(frozen=True, slots=True)
class SpringDriveConfig:
    """The [springdrive] table of stand.toml.

    stiffness: N m/rad at the motor shaft. damping: N m s/rad at the motor shaft.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    stiffness: Annotated[float, Gt(0)] = 0.02
    damping: Annotated[float, Gt(0)] = 2e-4


class SpringDrive(DriveServo):
    """One motor on a spring. Its torque goes off after 0.1 s without a request."""

    def __init__(self, config: SpringDriveConfig, *, clock: Clock | None = None) -> None:
        super().__init__(1, clock or VirtualClock())
        self._config = config
        self._angle, self._torque, self._at = 0.0, 0.0, self.clock.now()
        quantities = frozenset({Quantity.TORQUE})
        self._gate = Gate("springdrive", quantities, torque_off=self._torque_off, release=lambda: None)
        with self._gate.opening():
            self._gate.disarm()
        self.info = ServoInfo(backend="springdrive", model="spring", quantities=quantities, watchdog=0.1)

    def _arm(self, limits: Limits) -> None:
        del limits  # the gate keeps to them
        self._move(0.0)

    def _exchange(self, admitted: Admitted) -> Sample:
        now = self._move(0.0 if admitted.command is None else admitted.command.value)
        velocity = (self._torque - self._config.stiffness * self._angle) / self._config.damping
        return self._sample((now, now), self._angle, velocity, self._torque, saturated=admitted.clipped)

    def _torque_off(self, request: int) -> None:
        del request  # a drive may be asked several times until it confirms
        self._move(0.0)

    def _move(self, torque: float) -> float:
        """Let the time since the last request pass under its torque, set the new one, and return the time, s."""
        now, config = self.clock.now(), self._config
        settled = self._torque / config.stiffness
        self._angle = settled + (self._angle - settled) * exp(-(now - self._at) * config.stiffness / config.damping)
        self._at, self._torque = now, torque
        return now
