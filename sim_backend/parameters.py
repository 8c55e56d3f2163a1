"""The `[sim]` table of stand.toml: every parameter of the simulated stand, with its unit and its default.

The tables are plain frozen dataclasses. The bounds of single values are in the annotations, from which pydantic
validates a file. Conditions on several values are checked in `__post_init__`, with the key in the message. Joint-side
quantities have the paper's names; the names of motor-side quantities say so.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

from annotated_types import Ge, Gt, Le, Lt, Unit

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Delay = Annotated[float, Ge(0), Le(0.02)]
Counts = Annotated[int, Ge(4)]

# For whoever validates with pydantic: a misspelt key or a value that is not finite is an error.
_STRICT: dict[str, object] = {"extra": "forbid", "allow_inf_nan": False}

GEAR_RATIO = 4.0
MOTOR_INERTIA = 2e-7
MOTOR_DAMPING = 1e-7


@dataclass(frozen=True, slots=True)
class MotorParameters:
    """The motor and its winding. The first three values are `None` if the values of [stand] are to be used."""

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    gear_ratio: Positive | None = None
    """eta, turns of the motor for one turn of the joint; None: as in [stand]."""
    inertia: Annotated[Positive, Unit("kg*m^2")] | None = None
    """Dm, kg m^2 at the motor shaft; None: as in [stand]."""
    viscous_friction: Annotated[NotNegative, Unit("N*m*s/rad")] | None = None
    """Bm, N m s/rad at the motor shaft; None: as in [stand]."""
    torque_constant: Annotated[Positive, Unit("N*m/A")] = 0.0145
    """N m/A; it does not change with temperature."""
    winding_resistance: Annotated[Positive, Unit("ohm")] = 8.7
    """Ohm; it does not change with temperature."""
    winding_heat_capacity: Annotated[Positive, Unit("J/K")] = 1.4
    """J/K, of the winding."""
    winding_thermal_resistance: Annotated[Positive, Unit("K/W")] = 5.0
    """K/W, from winding to housing."""
    housing_heat_capacity: Annotated[Positive, Unit("J/K")] = 22.0
    """J/K, of the housing."""
    housing_thermal_resistance: Annotated[Positive, Unit("K/W")] = 20.0
    """K/W, from housing to ambient."""
    ambient_temperature: Annotated[float, Ge(-50), Le(100), Unit("degC")] = 23.0
    """degC; winding and housing start at this temperature."""


@dataclass(frozen=True, slots=True)
class CouplingParameters:
    """The cable between motor and joint. All values are at the joint side; a value of zero switches the element off."""

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    stiffness: Annotated[Positive, Unit("N*m/rad")] = 17.75e-3
    """Kc, N m/rad: linear stiffness."""
    damping: Annotated[NotNegative, Unit("N*m*s/rad")] = 0.19e-3
    """Bc, N m s/rad: viscous damping."""
    cubic: Annotated[NotNegative, Unit("N*m/rad^3")] = 0.0
    """K3, N m/rad^3: cubic stiffness, by which the cable stiffens with deflection."""
    coulomb_friction: Annotated[NotNegative, Unit("N*m")] = 2e-5
    """Fc, N m: friction of the sheath while sliding (LuGre model); 0: no dry friction at all."""
    static_friction_ratio: Annotated[float, Ge(1), Le(5)] = 1.25
    """Friction torque at rest divided by `coulomb_friction`."""
    stribeck_velocity: Annotated[Positive, Unit("rad/s")] = 0.05
    """rad/s of deflection rate at which the friction falls from static to Coulomb."""
    bristle_stiffness: Annotated[Positive, Unit("N*m/rad")] = 0.02
    """N m/rad: stiffness of the friction before it slides."""
    bristle_damping: Annotated[NotNegative, Unit("N*m*s/rad")] = 1e-5
    """N m s/rad: damping of the friction before it slides."""
    gap: Annotated[NotNegative, Unit("rad")] = 0.0
    """rad of deflection: full width of the backlash."""
    slack: Annotated[NotNegative, Unit("rad")] = 0.0
    """rad of deflection before a single tendon begins to pull (it pulls in one direction only); 0: a pretensioned
    pair.
    """
    hysteresis_torque: Annotated[NotNegative, Unit("N*m")] = 0.0
    """N m: torque of the Bouc-Wen element once it has yielded."""
    hysteresis_yield: Annotated[Positive, Unit("rad")] = 0.02
    """rad: `hysteresis_torque` divided by the element's initial stiffness."""
    hysteresis_exponent: Annotated[float, Ge(1), Le(10)] = 1.0
    """How sharply the Bouc-Wen element yields."""

    def __post_init__(self) -> None:
        if self.gap > 0.0 and self.slack > 0.0:
            raise ValueError("coupling.gap and coupling.slack exclude each other: a single tendon has no second flank")
        needed = self.bristle_damping * (self.static_friction_ratio - 1.0)
        if self.coulomb_friction > 0.0 and needed > self.damping:
            raise ValueError(
                f"coupling.bristle_damping {self.bristle_damping} would make the friction a source of energy: "
                f"bristle_damping * (static_friction_ratio - 1) must not exceed coupling.damping {self.damping}"
            )


@dataclass(frozen=True, slots=True)
class FixtureParameters:
    """The fixture that locks the joint, with a finite stiffness."""

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    stiffness: Annotated[Positive, Unit("N*m/rad")] = 20.0
    """N m/rad, from joint to ground."""
    damping: Annotated[NotNegative, Unit("N*m*s/rad")] = 2e-3
    """N m s/rad, from joint to ground."""
    palm: Annotated[Positive, Unit("N*m/rad")] = 1e9
    """N m/rad, stiffness of the palm, on which the fixtures of all joints of a hand stand."""
    inertia: Annotated[Positive, Unit("kg*m^2")] = 5e-6
    """kg m^2 of the locked joint."""


@dataclass(frozen=True, slots=True)
class DriveParameters:
    """The electronics and firmware of the simulated drive. All values are at the motor shaft."""

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    current_bandwidth: Annotated[float, Gt(0), Le(20_000), Unit("Hz")] = 1000.0
    """Hz, bandwidth of the current loop, first order."""
    torque_limit: Annotated[Positive, Unit("N*m")] = 5e-3
    """N m, the largest torque that the drive can make, whatever limits it is armed with."""
    loop_rate: Annotated[float, Ge(100), Le(50_000), Unit("Hz")] = 5000.0
    """Hz at which the firmware accepts set-points, closes the position loop and checks for faults."""
    position_gain: Annotated[NotNegative, Unit("N*m/rad")] = 0.02
    """N m/rad, proportional gain of the position loop."""
    position_integral_gain: Annotated[NotNegative, Unit("N*m/(rad*s)")] = 0.5
    """N m/(rad s), integral gain of the position loop."""
    position_damping_gain: Annotated[NotNegative, Unit("N*m*s/rad")] = 9e-5
    """N m s/rad, gain of the position loop on the filtered velocity."""
    command_delay: Annotated[Delay, Unit("s")] = 1e-4
    """s from the arrival of a set-point to the time at which the firmware may use it."""
    supply_voltage: Annotated[Positive, Unit("V")] = 12.0
    """V, the supply voltage that the drive reports."""


@dataclass(frozen=True, slots=True)
class SensorParameters:
    """The sensors of the simulated stand: resolution, delay and noise."""

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    motor_counts: Counts = 4096
    """Counts a turn of the motor encoder."""
    joint_counts: Counts = 16384
    """Counts a turn of the joint encoder."""
    joint_encoder: bool = True
    """Whether the joint has an encoder; without one the joint angle is NaN."""
    torque_cell: bool = True
    """Whether the locked joint rests on a torque cell; without one the joint torque is NaN."""
    reports_velocity: bool = True
    """Whether the drive reports a velocity; otherwise the velocity is NaN."""
    velocity_bandwidth: Annotated[float, Gt(0), Le(20_000), Unit("Hz")] = 200.0
    """Hz, bandwidth of the drive's velocity filter, first order."""
    velocity_lsb: Annotated[Positive, Unit("rad/s")] = 0.024
    """rad/s at the motor shaft, one count of velocity."""
    current_lsb: Annotated[Positive, Unit("A")] = 1e-3
    """A, one count of current; multiplied by the torque constant it is one count of motor torque."""
    motor_torque_noise: Annotated[NotNegative, Unit("N*m")] = 1e-5
    """N m at the motor shaft, standard deviation of the white noise of the motor torque."""
    torque_cell_noise: Annotated[NotNegative, Unit("N*m")] = 2e-4
    """N m at the joint, standard deviation of the white noise of the torque cell."""
    torque_cell_offset: Annotated[float, Unit("N*m")] = 5e-5
    """N m at the joint, error of the torque cell's zero."""
    torque_cell_drift: Annotated[float, Unit("N*m/s")] = 1e-6
    """N m/s at the joint, drift of the torque cell's zero since the servo was opened."""
    torque_cell_lsb: Annotated[Positive, Unit("N*m")] = 2e-5
    """N m at the joint, one count of the torque cell."""
    torque_cell_bandwidth: Annotated[float, Gt(0), Le(20_000), Unit("Hz")] = 2000.0
    """Hz, bandwidth of the torque cell, first order."""
    motor_position_delay: Annotated[Delay, Unit("s")] = 0.0
    """s, age of the motor angle and velocity when the drive answers."""
    motor_torque_delay: Annotated[Delay, Unit("s")] = 5e-5
    """s, age of the motor torque when the drive answers."""
    joint_position_delay: Annotated[Delay, Unit("s")] = 1e-4
    """s, age of the joint angle when the drive answers."""
    joint_torque_delay: Annotated[Delay, Unit("s")] = 5e-5
    """s, age of the torque cell's reading when the drive answers, without the delay of the cell's filter."""
    temperature_lsb: Annotated[Positive, Unit("K")] = 1.0
    """K, one count of the winding temperature."""


@dataclass(frozen=True, slots=True)
class LinkParameters:
    """The link between the computer and the simulated drive: durations, lost replies, watchdog."""

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    round_trip: Annotated[Positive, Unit("s")] = 6e-4
    """s, mean duration of request and reply together; each takes half of it on average."""
    jitter: Annotated[NotNegative, Unit("s")] = 2e-5
    """s, standard deviation of the durations of request and of reply. A time stamp is wrong by half the difference of
    the two durations.
    """
    lost_reply: Annotated[float, Ge(0), Lt(1)] = 1e-3
    """Probability that a reply is lost; the set-point arrives nevertheless."""
    reply_timeout: Annotated[Positive, Unit("s")] = 1.5e-3
    """s after which a reply counts as lost."""
    watchdog: Annotated[Positive, Unit("s")] = 0.1
    """s without an exchange after which an armed drive turns its torque off and latches a fault."""

    def __post_init__(self) -> None:
        if self.reply_timeout <= self.round_trip:
            raise ValueError(
                f"link.reply_timeout {self.reply_timeout} s is not longer than link.round_trip {self.round_trip} s: "
                "no reply would ever come in time"
            )
        if self.watchdog <= self.reply_timeout:
            raise ValueError(
                f"link.watchdog {self.watchdog} s is not longer than link.reply_timeout {self.reply_timeout} s: "
                "one lost reply would stop the drive"
            )


@dataclass(frozen=True, slots=True)
class SimParameters:
    """The simulated stand. The default is the paper's joint with realistic sensors."""

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    motor: MotorParameters = field(default_factory=MotorParameters)
    coupling: CouplingParameters = field(default_factory=CouplingParameters)
    fixture: FixtureParameters = field(default_factory=FixtureParameters)
    drive: DriveParameters = field(default_factory=DriveParameters)
    sensors: SensorParameters = field(default_factory=SensorParameters)
    link: LinkParameters = field(default_factory=LinkParameters)

    def __post_init__(self) -> None:
        lsb = self.sensors.current_lsb * self.motor.torque_constant
        if lsb > self.drive.torque_limit:
            raise ValueError(
                f"drive.torque_limit {self.drive.torque_limit} N m is below one count of the motor torque, "
                f"{lsb:.3g} N m: raise it or lower sensors.current_lsb"
            )

    @property
    def largest_torque(self) -> float:
        """The largest torque of the drive, N m at the motor shaft."""
        return self.drive.torque_limit

    def resolved(
        self,
        gear_ratio: float | None = None,
        motor_inertia: float | None = None,
        motor_damping: float | None = None,
    ) -> SimParameters:
        """Return these parameters with a value for every motor parameter that is None.

        A value in `[sim.motor]` is used first, then that of the stand (the arguments: gear_ratio -, motor_inertia kg
        m^2, motor_damping N m s/rad), then the default: a small coreless motor with a gear ratio of 4, with which the
        torque-driven resonance is near 12 Hz.
        """
        motor = replace(
            self.motor,
            gear_ratio=_first(self.motor.gear_ratio, gear_ratio, GEAR_RATIO),
            inertia=_first(self.motor.inertia, motor_inertia, MOTOR_INERTIA),
            viscous_friction=_first(self.motor.viscous_friction, motor_damping, MOTOR_DAMPING),
        )
        return replace(self, motor=motor)


def _first(stated: float | None, stand: float | None, default: float) -> float:
    if stated is not None:
        return stated
    return stand if stand is not None else default
