"""The physics of the stand in continuous time, and nothing else: no drive firmware, no counts, no link.

The state is a vector; its components are named by the constants below. Everything at the motor is at its shaft,
everything at the joint is at the joint. Equation numbers are the paper's.
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
"""sigma_m, N m: what the current makes."""
MOTOR = 1
"""theta_m, rad."""
MOTOR_RATE = 2
"""rad/s."""
JOINT = 3
"""theta_c, rad: nearly constant, because the joint is locked."""
JOINT_RATE = 4
"""rad/s."""
BRISTLE = 5
"""rad: mean deflection of the friction's bristles (LuGre)."""
HYSTERESIS = 6
"""-: the Bouc-Wen element's load over its yield load, -1 to 1."""
WINDING = 7
"""degC."""
HOUSING = 8
"""degC."""
CELL = 9
"""N m: the torque cell's output before it is sampled."""
VELOCITY = 10
"""rad/s: the drive's velocity filter."""
STATES = 11

_BEYOND_STRIBECK = 100.0
"""Squares of a relative rate from which exp(-square), 4e-44, is less than the last digit of what it is added to."""


class Constants(NamedTuple):
    """The plant's parameters as the equations want them (units as in `parameters`; rates in 1/s).

    The compiled functions take the same names as a record (`packed`).
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
    """The plant's constants from the stand's parameters, with open motor parameters at their defaults."""
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
    """Return the constants as an array of one record, (1,), which a compiled function takes over in 0.2 us."""
    return np.array([c], dtype=[(name, np.float64) for name in Constants._fields])


def fastest_rate(c: Constants) -> float:
    """1/s, the fastest of the stand's parts on its own: what the integrator's steps have to follow.

    Of an inertia on a spring and a damper the larger root of J s^2 + B s + K, in magnitude.
    """
    square = c.gear_ratio**2
    motor = (c.inertia, c.viscous_friction + c.damping / square, c.stiffness / square)
    joint = (c.joint_inertia, c.fixture_damping + c.damping, c.fixture_stiffness + c.stiffness)
    roots = [float(np.abs(np.roots(part)).max()) for part in (motor, joint)]
    return max(*roots, c.current_rate, c.cell_rate, c.velocity_rate)


def at_rest(c: Constants) -> Vector:
    """The state nobody has touched: no torque, no deflection, everything at ambient temperature. Shape (STATES,)."""
    state = np.zeros(STATES)
    state[WINDING] = state[HOUSING] = c.ambient
    return state


@compiled_within
def elastic_torque(deflection: float, rate: float, c: Constants) -> float:
    """Torque in spring and damper, N m, from the deflection, rad, and its rate, rad/s (equation 2 and what it lacks).

    With a gap or slack the flanks can push (the tendon pull) but not stick: damping never turns the torque round.
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
    """Return the rate at which the friction's bristles bend, rad/s (LuGre); zero without dry friction."""
    if c.coulomb == 0.0:
        return 0.0
    square = (rate / c.stribeck) * (rate / c.stribeck)
    level = c.coulomb
    if square < _BEYOND_STRIBECK:
        level += (c.static - c.coulomb) * math.exp(-square)
    return rate - c.bristle_stiffness * abs(rate) * bristle / level


@compiled_within
def hysteresis_rate(load: float, rate: float, c: Constants) -> float:
    """Return the rate of the Bouc-Wen element's relative load, 1/s: linear on unloading, yielding on loading."""
    if c.hysteresis_torque == 0.0:
        return 0.0
    yielded = abs(load) ** c.hysteresis_exponent if rate * load > 0.0 else 0.0
    return rate * (1.0 - yielded) / c.hysteresis_yield


@compiled_within
def passed_on(state: Vector, deflection: float, rate: float, bending: float, c: Constants) -> float:
    """sigma_c, N m, where the deflection, rad, its rate and the bristles' rate, rad/s, are known already."""
    friction = c.bristle_stiffness * state[BRISTLE] + c.bristle_damping * bending
    return float(elastic_torque(deflection, rate, c) + friction + c.hysteresis_torque * state[HYSTERESIS])


@compiled_no_refcount
def coupling_torque(state: Vector, constants: Packed) -> float:
    """Return the torque that the coupling transmits to the joint, sigma_c, N m, of a plant's state (STATES,)."""
    c = constants[0]
    deflection = state[MOTOR] / c.gear_ratio - state[JOINT]
    rate = state[MOTOR_RATE] / c.gear_ratio - state[JOINT_RATE]
    return passed_on(state, deflection, rate, bristle_rate(state[BRISTLE], rate, c), c)


@compiled_within
def derivatives(state: Vector, demand: float, c: Constants, out: Vector) -> None:
    """Write the rate of change of `state` into `out`, both of shape (STATES,).

    demand: the motor torque the current loop is asked for, N m.
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
