"""The plant against closed forms and against a second solver with equations of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from sim_backend import plant
from sim_backend.integrator import CLOCK, STATE, WRITTEN, integrate, recall, start
from sim_backend.parameters import CouplingParameters, FixtureParameters, SimParameters
from sim_backend.plant import packed

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

LINEAR = CouplingParameters(coulomb_friction=0.0)
COUPLINGS = {
    "linear": LINEAR,
    "cubic": replace(LINEAR, cubic=0.3),
    "lugre": CouplingParameters(coulomb_friction=5e-4),
    "hysteresis": replace(LINEAR, hysteresis_torque=1e-3),
    "backlash": replace(LINEAR, gap=0.05),
    "slack": replace(LINEAR, slack=0.03),
    "everything": CouplingParameters(coulomb_friction=1e-4, cubic=0.1, gap=0.02, hysteresis_torque=3e-4),
}


def swept(parameters: SimParameters, demands: Vector, hold: float, state: Vector | None = None) -> Vector:
    """The states, (len(demands), STATES), after each demand has been held for `hold` s."""
    c = plant.constants(parameters)
    path = start(c)
    if state is not None:
        path[STATE, : plant.STATES] = state
    record = packed(c)
    rows = []
    for k, demand in enumerate(demands):
        integrate(path, float(demand), (k + 1) * hold, record)
        rows.append(path[STATE, : plant.STATES].copy())
    return np.array(rows)


def torques(parameters: SimParameters, states: Vector) -> Vector:
    record = packed(plant.constants(parameters))
    return np.array([plant.coupling_torque(state, record) for state in states])


def relative(a: Vector, b: Vector) -> float:
    return float(np.max(np.abs(a - b)) / np.max(np.abs(b)))


def test_a_torque_step_gives_the_closed_form_of_a_damped_second_order_system_behind_a_lag() -> None:
    immovable = FixtureParameters(inertia=1e9)
    parameters = SimParameters(coupling=LINEAR, fixture=immovable)
    c = plant.constants(parameters)
    states = swept(parameters, np.full(150, 1.5e-3), 2e-3)
    t = 2e-3 * np.arange(1, 151)
    lag = c.current_rate
    poles = np.roots([c.inertia, c.viscous_friction + c.damping / c.gear_ratio**2, c.stiffness / c.gear_ratio**2])
    every = np.array([0.0, -lag, *poles], dtype=np.complex128)
    angle = np.zeros(t.size)
    rate = np.zeros(t.size)
    for i, pole in enumerate(every):
        residue = 1.5e-3 * lag / c.inertia / np.prod(pole - np.delete(every, i))
        angle += np.real(residue * np.exp(pole * t))
        rate += np.real(residue * pole * np.exp(pole * t))
    assert relative(states[:, plant.MOTOR], angle) < 1e-6
    assert relative(states[:, plant.MOTOR_RATE], rate) < 1e-6


def test_the_whole_linear_plant_agrees_with_its_matrix_exponential() -> None:
    parameters = SimParameters(coupling=LINEAR)
    c = plant.constants(parameters)
    n, j = c.gear_ratio, c.joint_inertia
    cable = np.array([0.0, c.stiffness / n, c.damping / n, -c.stiffness, -c.damping])
    matrix = np.zeros((6, 6))
    matrix[0, [0, 5]] = -c.current_rate, c.current_rate
    matrix[1, 2] = matrix[3, 4] = 1.0
    matrix[2, :5] = -cable / n / c.inertia
    matrix[2, 0] += 1.0 / c.inertia
    matrix[2, 2] -= c.viscous_friction / c.inertia
    matrix[4, :5] = cable / j
    matrix[4, 3] -= c.fixture_stiffness / j
    matrix[4, 4] -= c.fixture_damping / j
    states = swept(parameters, np.full(100, 1e-3), 2e-3)
    x = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-3])
    step = expm(matrix * 2e-3)
    expected = []
    for _ in range(100):
        x = step @ x
        expected.append(x[:5])
    for component in range(5):
        assert relative(states[:, component], np.array(expected)[:, component]) < 1e-6


class Reference:
    """The same physics written a second time, piecewise smooth: it stops at every corner and starts anew behind it.

    State: sigma_m, theta_m, its rate, theta_c, its rate, bristles, Bouc-Wen load, torque cell.
    """

    def __init__(self, parameters: SimParameters) -> None:
        p = parameters.resolved()
        self.p, self.q = p, p.coupling
        self.ratio = p.motor.gear_ratio or math.nan
        self.flanks = [(side, side * self.q.gap / 2) for side in (-1, 1)] if self.q.gap else []
        self.flanks += [(1, self.q.slack)] if self.q.slack else []
        self.touching = [(1, 0.0)] * (not self.flanks)
        self.way = self.sign = 1.0

    def rate(self, y: Vector) -> float:
        return float(y[2] / self.ratio - y[4])

    def stretch(self, y: Vector, at: float) -> float:
        return float(y[1] / self.ratio - y[3] - at)

    def pull(self, y: Vector, at: float) -> float:
        s = self.stretch(y, at)
        return self.q.stiffness * s + self.q.cubic * s**3 + self.q.damping * self.rate(y)

    def bend(self, y: Vector) -> float:
        q, rate = self.q, self.rate(y)
        if q.coulomb_friction == 0:
            return 0.0
        stribeck = math.exp(-((rate / q.stribeck_velocity) ** 2))
        level = q.coulomb_friction * (1 + (q.static_friction_ratio - 1) * stribeck)
        return float(rate * (1 - self.way * q.bristle_stiffness * y[5] / level))

    def torque(self, y: Vector) -> float:
        q = self.q
        elastic = sum(self.pull(y, at) for _, at in self.touching)
        friction = q.bristle_stiffness * y[5] + q.bristle_damping * self.bend(y)
        return float(elastic + friction + q.hysteresis_torque * y[6])

    def slope(self, _t: float, y: Vector, demand: float) -> list[float]:
        p, q, tau = self.p, self.q, self.torque(y)
        held = p.fixture.stiffness * y[3] + p.fixture.damping * y[4]
        yielding = abs(y[6]) ** q.hysteresis_exponent if self.way == self.sign else 0.0
        load = self.rate(y) / q.hysteresis_yield * (1 - yielding) if q.hysteresis_torque else 0.0
        motor = y[0] - (p.motor.viscous_friction or math.nan) * y[2] - tau / self.ratio
        lag, cell = 2 * math.pi * p.drive.current_bandwidth, 2 * math.pi * p.sensors.torque_cell_bandwidth
        acceleration, joint = motor / (p.motor.inertia or math.nan), (tau - held) / p.fixture.inertia
        return [lag * (demand - y[0]), y[2], acceleration, y[4], joint, self.bend(y), load, cell * (held - y[7])]

    def corners(self) -> list[Callable[..., float]]:
        """What is zero where the equations change: the rate, the Bouc-Wen load, each flank and its torque."""
        found: list[Callable[..., float]] = []
        if self.q.coulomb_friction or self.q.hysteresis_torque:
            found.append(lambda _t, y, _demand: self.rate(y))
        if self.q.hysteresis_torque:
            found.append(lambda _t, y, _demand: float(y[6]))
        for _, at in self.flanks:
            found.append(lambda _t, y, _demand, at=at: self.stretch(y, at))
            found.append(lambda _t, y, _demand, at=at: self.pull(y, at))
        for corner in found:
            corner.terminal = True  # type: ignore[attr-defined]  # scipy's way of marking an event
        return found

    def settle(self, y: Vector) -> None:
        """See which of the equations hold just here."""
        self.way, self.sign = math.copysign(1, self.rate(y)), math.copysign(1, y[6])
        if self.flanks:
            self.touching = [
                (side, at) for side, at in self.flanks if self.stretch(y, at) * side > 0 and self.pull(y, at) * side > 0
            ]

    def sweep(self, demands: Vector, hold: float) -> tuple[Vector, Vector]:
        """States, (n, 8), and coupling torque, (n,), after each demand."""
        y, rows, tau, nudge = np.zeros(8), [], [], 1e-11
        for demand in demands:
            t = 0.0
            while t < hold - nudge:
                y, t = y + nudge * np.array(self.slope(t, y, demand)), t + nudge  # past the corner, onto one side of it
                self.settle(y)
                run = solve_ivp(
                    self.slope, (t, hold), y, "DOP853", events=self.corners(), args=(demand,), rtol=1e-10, atol=1e-14
                )
                t, y = run.t[-1], run.y[:, -1]
            rows.append(y)
            tau.append(self.torque(y))
        return np.array(rows), np.array(tau)


@pytest.mark.parametrize("name", ["lugre", "slack", "everything"])
def test_the_plant_agrees_with_an_independent_solver_that_stops_at_every_corner(name: str) -> None:
    parameters = SimParameters(coupling=COUPLINGS[name])
    hold = 4e-3
    demands = 1.5e-3 * np.sin(2.0 * np.pi * 9.0 * hold * (np.arange(18) + 1.0))
    states = swept(parameters, demands, hold)
    expected, tau = Reference(parameters).sweep(demands, hold)
    for component, other in ((plant.MOTOR, 1), (plant.MOTOR_RATE, 2), (plant.JOINT, 3), (plant.CELL, 7)):
        assert relative(states[:, component], expected[:, other]) < 1e-6
    assert relative(torques(parameters, states), tau) < 1e-6


def energies(parameters: SimParameters, states: Vector) -> Vector:
    """Kinetic and stored energy, J, at each of the states."""
    c, q = plant.constants(parameters), parameters.coupling
    deflection = states[:, plant.MOTOR] / c.gear_ratio - states[:, plant.JOINT]
    stretch = np.maximum(np.abs(deflection) - 0.5 * q.gap, 0.0)
    if q.slack:
        stretch = np.maximum(deflection - q.slack, 0.0)
    energy = c.inertia * states[:, plant.MOTOR_RATE] ** 2 + c.joint_inertia * states[:, plant.JOINT_RATE] ** 2
    energy += c.fixture_stiffness * states[:, plant.JOINT] ** 2
    energy += q.stiffness * stretch**2 + 0.5 * q.cubic * stretch**4
    energy += q.bristle_stiffness * states[:, plant.BRISTLE] ** 2
    energy += q.hysteresis_torque * q.hysteresis_yield * states[:, plant.HYSTERESIS] ** 2
    return np.asarray(0.5 * energy)


@pytest.mark.parametrize("name", COUPLINGS)
def test_a_wound_cable_let_go_never_gains_energy(name: str) -> None:
    parameters = SimParameters(coupling=COUPLINGS[name])
    wound = plant.at_rest(plant.constants(parameters))
    wound[plant.MOTOR] = 1.2
    states = swept(parameters, np.zeros(600), 5e-4, wound)
    energy = energies(parameters, np.vstack([wound, states]))
    assert max(after - before for before, after in pairwise(energy)) <= 1e-9 * energy[0]
    assert energy[-1] < 0.5 * energy[0]


def test_the_hysteresis_element_loads_along_its_exponential_whatever_the_speed() -> None:
    coupling = replace(LINEAR, hysteresis_torque=1e-3, hysteresis_yield=0.05)
    parameters = SimParameters(coupling=coupling)
    states = swept(parameters, np.full(12, 1.5e-3), 2e-3)
    deflection = states[:, plant.MOTOR] / 4.0 - states[:, plant.JOINT]
    assert np.all(np.diff(deflection) > 0.0)
    assert relative(states[:, plant.HYSTERESIS], 1.0 - np.exp(-deflection / 0.05)) < 1e-6


def test_dry_friction_holds_below_its_static_level_and_slides_at_its_coulomb_level() -> None:
    coupling = CouplingParameters(stiffness=1e-6, damping=1e-4, coulomb_friction=1e-3, stribeck_velocity=2.0)
    parameters = SimParameters(coupling=coupling)
    wound_up = np.minimum(np.linspace(0.0, 2.0, 400), 1.0)
    held = swept(parameters, 1.15e-3 / 4.0 * wound_up, 0.02)[-1]
    slid = swept(parameters, 3e-3 / 4.0 * wound_up, 0.02)[-1]
    assert abs(held[plant.MOTOR_RATE]) < 1e-3
    assert slid[plant.MOTOR_RATE] > 10.0
    assert coupling.bristle_stiffness * held[plant.BRISTLE] == pytest.approx(1.15e-3, rel=1e-3)
    assert coupling.bristle_stiffness * slid[plant.BRISTLE] == pytest.approx(1e-3, rel=1e-6)


def test_a_slack_tendon_only_pulls() -> None:
    parameters = SimParameters(coupling=COUPLINGS["slack"])
    states = swept(parameters, np.repeat([1e-3, -1e-3, 1e-3], 100), 1e-3)
    assert torques(parameters, states).min() == 0.0
    assert torques(parameters, states).max() > 1e-3


def test_the_winding_warms_as_its_two_heat_capacities_say() -> None:
    parameters = SimParameters()
    c = plant.constants(parameters)
    warm = plant.at_rest(c)
    warm[plant.TORQUE] = 4e-3
    states = swept(parameters, np.full(10, 4e-3), 1.0, warm)
    matrix = np.zeros((3, 3))
    matrix[0] = (
        -1 / (c.winding_resistance * c.winding_capacity),
        1 / (c.winding_resistance * c.winding_capacity),
        8.7 * (4e-3 / 0.0145) ** 2 / c.winding_capacity,
    )
    matrix[1, 0] = 1 / (c.winding_resistance * c.housing_capacity)
    matrix[1, 1] = -matrix[1, 0] - 1 / (c.housing_resistance * c.housing_capacity)
    rises = np.array([(expm(matrix * t) @ [0.0, 0.0, 1.0])[0] for t in range(1, 11)])
    assert relative(states[:, plant.WINDING] - 23.0, rises) < 1e-6


def test_the_past_is_remembered_between_the_steps_and_said_to_be_forgotten_beyond() -> None:
    parameters = SimParameters(coupling=LINEAR)
    c = plant.constants(parameters)
    record = packed(c)
    path, there = start(c), np.zeros(plant.STATES)
    integrate(path, 1e-3, 0.02, record)
    fresh = start(c)
    integrate(fresh, 1e-3, 0.01234, record)
    assert recall(path, 0.01234, there)
    np.testing.assert_allclose(there[: plant.BRISTLE], fresh[STATE, : plant.BRISTLE], rtol=1e-6)
    assert recall(path, -1.0, there)
    np.testing.assert_array_equal(there, plant.at_rest(c))
    for tick in range(300):
        integrate(path, 1e-3 * (tick % 2), 0.02 + 2e-3 * (tick + 1), record)
    assert not recall(path, 0.02, there)


@pytest.mark.parametrize("stiffness", [1e6, 1e7])
def test_the_fastest_rate_is_the_stiff_fixtures_and_the_steps_follow_it(stiffness: float) -> None:
    parameters = SimParameters(fixture=FixtureParameters(stiffness=stiffness, damping=0.0, inertia=5e-6))
    c = plant.constants(parameters)
    rate = plant.fastest_rate(c)
    assert rate == pytest.approx(math.sqrt(stiffness / 5e-6), rel=1e-3)
    path = start(c)
    integrate(path, 1e-3, 0.05, packed(c))
    assert path[CLOCK, WRITTEN] / 0.05 == pytest.approx(rate, rel=0.4)


def test_the_default_stand_is_not_a_slow_one() -> None:
    assert plant.fastest_rate(plant.constants(SimParameters())) == pytest.approx(2.0 * math.pi * 2000.0)  # the cell's
