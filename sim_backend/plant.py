"""The equations of the stand's physics in continuous time: without drive firmware, rounding to counts or link.

The state is a vector, whose components are named by the constants below. Motor quantities are at the motor shaft, joint
quantities at the joint. Equation numbers are those of the paper.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount, compiled_within

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters

Vector = NDArray[np.float64]
Packed = NDArray[np.void]

TORQUE = 0
"""Component of the state: motor torque that the current makes, sigma_m, N m."""
MOTOR = 1
"""Component of the state: motor angle, theta_m, rad."""
MOTOR_RATE = 2
"""Component of the state: motor velocity, rad/s."""
JOINT = 3
"""Component of the state: joint angle, theta_c, rad. It is nearly constant, because the joint is locked."""
JOINT_RATE = 4
"""Component of the state: joint velocity, rad/s."""
BRISTLE = 5
"""Component of the state: mean deflection of the friction's bristles (LuGre), rad."""
HYSTERESIS = 6
"""Component of the state: load of the Bouc-Wen element divided by its yield load, -1 to 1."""
WINDING = 7
"""Component of the state: temperature of the winding, degC."""
HOUSING = 8
"""Component of the state: temperature of the housing, degC."""
CELL = 9
"""Component of the state: output of the torque cell before sampling, N m."""
VELOCITY = 10
"""Component of the state: output of the drive's velocity filter, rad/s."""
STATES = 11

_BEYOND_STRIBECK = 100.0
"""Square of the relative rate above which exp(-square) is neglected: it is then below 4e-44 and does not change the
sum.
"""


class Constants(NamedTuple):
    """The plant's parameters in the form that the equations need. Units as in `parameters`; rates in 1/s.

    `packed` converts them to the record that the compiled functions take.
    """

    gear_ratio: float
    inertia: float
    viscous_friction: float
    stiffness: float
    damping: float
    cubic: float
    coulomb: float
    static: float
    stribeck: float
    bristle_stiffness: float
    bristle_damping: float
    gap: float
    slack: float
    hysteresis_torque: float
    hysteresis_yield: float
    hysteresis_exponent: float
    fixture_stiffness: float
    fixture_damping: float
    joint_inertia: float
    current_rate: float
    cell_rate: float
    velocity_rate: float
    heating: float
    winding_capacity: float
    winding_resistance: float
    housing_capacity: float
    housing_resistance: float
    ambient: float


def constants(parameters: SimParameters) -> Constants:
    """Return the plant's constants for the stand's parameters. Motor parameters that are None get their defaults."""
    stand = parameters.resolved()
    motor, coupling, fixture = stand.motor, stand.coupling, stand.fixture
    assert motor.gear_ratio is not None  # noqa: S101 - `resolved` leaves none open; for the type checker
    assert motor.inertia is not None  # noqa: S101 - the same
    assert motor.viscous_friction is not None  # noqa: S101 - the same
    return Constants(
        gear_ratio=float(motor.gear_ratio),
        inertia=float(motor.inertia),
        viscous_friction=float(motor.viscous_friction),
        stiffness=float(coupling.stiffness),
        damping=float(coupling.damping),
        cubic=float(coupling.cubic),
        coulomb=float(coupling.coulomb_friction),
        static=float(coupling.coulomb_friction * coupling.static_friction_ratio),
        stribeck=float(coupling.stribeck_velocity),
        bristle_stiffness=float(coupling.bristle_stiffness),
        bristle_damping=float(coupling.bristle_damping),
        gap=float(coupling.gap),
        slack=float(coupling.slack),
        hysteresis_torque=float(coupling.hysteresis_torque),
        hysteresis_yield=float(coupling.hysteresis_yield),
        hysteresis_exponent=float(coupling.hysteresis_exponent),
        fixture_stiffness=float(fixture.stiffness),
        fixture_damping=float(fixture.damping),
        joint_inertia=float(fixture.inertia),
        current_rate=2.0 * math.pi * stand.drive.current_bandwidth,
        cell_rate=2.0 * math.pi * stand.sensors.torque_cell_bandwidth,
        velocity_rate=2.0 * math.pi * stand.sensors.velocity_bandwidth,
        heating=motor.winding_resistance / motor.torque_constant**2,
        winding_capacity=float(motor.winding_heat_capacity),
        winding_resistance=float(motor.winding_thermal_resistance),
        housing_capacity=float(motor.housing_heat_capacity),
        housing_resistance=float(motor.housing_thermal_resistance),
        ambient=float(motor.ambient_temperature),
    )


def packed(c: Constants) -> Packed:
    """Return the constants as an array of one record, shape (1,), which a compiled function accepts in 0.2 us."""
    return np.array([c], dtype=[(name, np.float64) for name in Constants._fields])


def fastest_rate(c: Constants) -> float:
    """Return the fastest rate of the stand's parts, each taken alone, 1/s. The integrator's steps must be short enough
    for this rate.

    For an inertia on a spring and a damper, the rate is the larger magnitude of the roots of J s^2 + B s + K.
    """
    square = c.gear_ratio**2
    motor = (c.inertia, c.viscous_friction + c.damping / square, c.stiffness / square)
    joint = (c.joint_inertia, c.fixture_damping + c.damping, c.fixture_stiffness + c.stiffness)
    roots = [float(np.abs(np.roots(part)).max()) for part in (motor, joint)]
    return max(*roots, c.current_rate, c.cell_rate, c.velocity_rate)


def at_rest(c: Constants) -> Vector:
    """Return the state at rest, (STATES,): no torque, no deflection, all temperatures at ambient."""
    state = np.zeros(STATES)
    state[WINDING] = state[HOUSING] = c.ambient
    return state


@compiled_within
def elastic_torque(deflection: float, rate: float, c: Constants) -> float:
    """Return the torque of spring and damper, N m. deflection: rad. rate: its rate, rad/s.

    This is equation 2 of the paper plus cubic stiffness, gap and slack. With a gap, contact can push but not stick;
    with slack, the tendon can only pull. So damping never reverses the sign of the torque.
    """
    if c.gap == 0.0 and c.slack == 0.0:
        return c.stiffness * deflection + c.cubic * (deflection * deflection * deflection) + c.damping * rate
    if c.gap > 0.0:
        stretch = deflection - math.copysign(0.5 * c.gap, deflection) if abs(deflection) > 0.5 * c.gap else 0.0
    else:
        stretch = deflection - c.slack if deflection > c.slack else 0.0
    torque = c.stiffness * stretch + c.cubic * (stretch * stretch * stretch) + c.damping * rate
    return torque if torque * stretch > 0.0 else 0.0


@compiled_within
def bristle_rate(bristle: float, rate: float, c: Constants) -> float:
    """Return the rate at which the friction's bristles deflect, rad/s (LuGre); zero without dry friction.

    bristle: their deflection, rad. rate: deflection rate of the coupling, rad/s.
    """
    if c.coulomb == 0.0:
        return 0.0
    square = (rate / c.stribeck) * (rate / c.stribeck)
    level = c.coulomb
    if square < _BEYOND_STRIBECK:
        level += (c.static - c.coulomb) * math.exp(-square)
    return rate - c.bristle_stiffness * abs(rate) * bristle / level


@compiled_within
def hysteresis_rate(load: float, rate: float, c: Constants) -> float:
    """Return the rate of the Bouc-Wen element's relative load, 1/s. The element is linear when unloading and yields
    when loading.

    load: relative load, -1 to 1. rate: deflection rate of the coupling, rad/s.
    """
    if c.hysteresis_torque == 0.0:
        return 0.0
    yielded = abs(load) ** c.hysteresis_exponent if rate * load > 0.0 else 0.0
    return rate * (1.0 - yielded) / c.hysteresis_yield


@compiled_within
def passed_on(state: Vector, deflection: float, rate: float, bending: float, c: Constants) -> float:
    """Return the torque that the coupling transmits to the joint, sigma_c, N m, from rates that are known already.

    deflection: of the coupling, rad; rate: deflection rate, rad/s. bending: rate of the friction's bristles, rad/s.
    """
    friction = c.bristle_stiffness * state[BRISTLE] + c.bristle_damping * bending
    return float(elastic_torque(deflection, rate, c) + friction + c.hysteresis_torque * state[HYSTERESIS])


@compiled_no_refcount
def coupling_torque(state: Vector, constants: Packed) -> float:
    """Return the torque that the coupling transmits to the joint, sigma_c, N m. state: state of the plant,
    (STATES,).
    """
    c = constants[0]
    deflection = state[MOTOR] / c.gear_ratio - state[JOINT]
    rate = state[MOTOR_RATE] / c.gear_ratio - state[JOINT_RATE]
    return passed_on(state, deflection, rate, bristle_rate(state[BRISTLE], rate, c), c)


@compiled_no_refcount
def derivatives(state: Vector, demand: float, c: Constants, out: Vector) -> None:
    """Write the rate of change of `state` into `out`; both have the shape (STATES,).

    demand: the motor torque that is demanded of the current loop, N m.
    """
    deflection = state[MOTOR] / c.gear_ratio - state[JOINT]
    rate = state[MOTOR_RATE] / c.gear_ratio - state[JOINT_RATE]
    bending = bristle_rate(state[BRISTLE], rate, c)
    torque = passed_on(state, deflection, rate, bending, c)
    held = c.fixture_stiffness * state[JOINT] + c.fixture_damping * state[JOINT_RATE]
    out[TORQUE] = c.current_rate * (demand - state[TORQUE])
    out[MOTOR] = state[MOTOR_RATE]
    out[MOTOR_RATE] = (
        state[TORQUE] - c.viscous_friction * state[MOTOR_RATE] - torque / c.gear_ratio
    ) / c.inertia  # equation 1
    out[JOINT] = state[JOINT_RATE]
    out[JOINT_RATE] = (torque - held) / c.joint_inertia
    out[BRISTLE] = bending
    out[HYSTERESIS] = hysteresis_rate(state[HYSTERESIS], rate, c)
    flow = (state[WINDING] - state[HOUSING]) / c.winding_resistance
    lost = (state[HOUSING] - c.ambient) / c.housing_resistance
    out[WINDING] = (c.heating * (state[TORQUE] * state[TORQUE]) - flow) / c.winding_capacity
    out[HOUSING] = (flow - lost) / c.housing_capacity
    out[CELL] = c.cell_rate * (held - state[CELL])
    out[VELOCITY] = c.velocity_rate * (state[MOTOR_RATE] - state[VELOCITY])
