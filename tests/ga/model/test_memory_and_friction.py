"""Terms with memory and those of friction, against closed forms and scipy's integrator."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import cont2discrete, lfilter

from ga.model.coupling import CouplingModel, parse
from ga.model.separable import Fit, Problem, fit
from ga.model.sticking import is_hidden, looks_like_spring
from ga.model.trajectory import Motion

Array = NDArray[np.float64]

KC, BC = 0.3, 3e-3
LINES = 2.0 * np.pi * np.array([0.3, 0.7, 1.3, 2.2, 3.7, 5.9, 8.3, 11.0])
PHASES = np.array([0.3, 2.1, 4.0, 5.5, 1.2, 3.3, 0.9, 2.7])
SIZES = 0.06 / (1.0 + np.arange(8) / 4.0)
NOISE = 3e-4


def moving(time: Array) -> Motion:
    """A sum of sines from 0.3 to 11 Hz, in closed form at any time."""
    waves = SIZES * np.exp(1j * (np.outer(time, LINES) + PHASES))
    parts = [(waves * (1j * LINES) ** order).sum(axis=1).imag for order in range(3)]
    return Motion(time, parts[0], parts[1], parts[2], np.zeros(len(time)))


def uneven(count: int = 4000, step: float = 2.5e-3) -> Array:
    return step * (np.arange(count) + np.random.default_rng(3).uniform(-0.3, 0.3, count))


MOTION = moving(uneven())
NOISES = NOISE * np.random.default_rng(5).standard_normal(len(MOTION))


def steady_lag(time: Array, constant: float, order: int = 0) -> Array:
    """The closed form of the deflection (or a derivative) behind a first-order lag, long after the start."""
    waves = SIZES * np.exp(1j * (np.outer(time, LINES) + PHASES)) * (1j * LINES) ** order
    return np.asarray((waves / (1.0 + 1j * LINES * constant)).sum(axis=1).imag)


def problem(name: str, torque: Array, motion: Motion = MOTION) -> Problem:
    model = parse(name).anchored(motion)
    return Problem(model, motion, torque, *model.bounds(motion, highest=11.0))


def values(found: Fit, model: CouplingModel) -> dict[str, float]:
    return dict(zip((parameter.name for parameter in model.parameters), found.values.tolist(), strict=True))


def identified(name: str, torque: Array, motion: Motion = MOTION) -> dict[str, float]:
    asked = problem(name, torque, motion)
    return values(fit(asked), parse(name))


def spring_and_damper(motion: Motion = MOTION) -> Array:
    return KC * motion.dtheta + BC * motion.dtheta_dot


@pytest.mark.parametrize("constant", [1e-4, 5e-3, 0.03, 0.4])
def test_a_lag_is_that_of_the_closed_form_on_uneven_stamps(constant: float) -> None:
    settled = MOTION.time > MOTION.time[0] + 12.0 * constant
    lagged = MOTION.lagged(MOTION.dtheta, constant)
    assert lagged[settled] == pytest.approx(steady_lag(MOTION.time, constant)[settled], abs=5e-5)


def test_a_lag_of_a_cubic_is_exact() -> None:
    """y = p - T p' + T^2 p'' - T^3 p''' + c exp(-t/T); a parabola has the slopes of central differences."""
    time = uneven(50)
    time -= time[0]
    square = Motion(time, time**2, 2.0 * time, np.full(50, 2.0), np.zeros(50)).lagged(time**2, 0.02)
    exact = time**2 - 0.04 * time + 8e-4 * (1.0 - np.exp(-time / 0.02))
    assert square[:-1] == pytest.approx(exact[:-1], abs=1e-6)


def test_a_lag_begins_anew_in_every_stretch() -> None:
    time, dtheta, rate = (np.concatenate([part, part]) for part in (MOTION.time, MOTION.dtheta, MOTION.dtheta_dot))
    still = np.zeros(len(time))
    twice = Motion(time, dtheta, rate, still, still, starts=(0, len(MOTION)))
    lagged = twice.lagged(twice.dtheta + np.repeat([0.0, 5.0], len(MOTION)), 0.03)
    assert lagged[len(MOTION) :] - 5.0 == pytest.approx(lagged[: len(MOTION)], abs=1e-9)


@pytest.mark.parametrize(
    "name",
    ["linear+offset+lag", "linear+offset+skew+lag", "linear+maxwell", "linear+dahl", "linear+boucwen"],
)
def test_some_rows_remember_the_samples_between_them(name: str) -> None:
    model = parse(name).anchored(MOTION)
    nonlinear, _ = model.bounds(MOTION, 11.0)
    nonlinear = nonlinear + 0.01
    rows = np.arange(len(MOTION)) % 7 == 3
    part = MOTION.of(rows).of(slice(None, None, 2))
    whole = model.columns(MOTION, nonlinear)[rows][::2]
    late = part.time > 2.0  # before, the unknown state at the beginning is left out, which other rows know otherwise
    assert np.array_equal(model.columns(part, nonlinear)[late], whole[late])


@pytest.mark.parametrize("constant", [0.005, 0.05])
def test_a_recording_may_begin_in_the_middle_of_a_motion(constant: float) -> None:
    """What the cell remembers of before is unknown: taken for settled, it was as large as 30 times the noise."""
    torque = KC * steady_lag(MOTION.time, constant) + BC * steady_lag(MOTION.time, constant, 1)
    asked = problem("linear+lag", torque)
    found = asked.solve(np.array([constant]))
    assert np.abs(asked.residuals(found)).max() < 2e-3 * np.abs(torque).max()
    assert np.allclose(found.optimum.genes, [KC, BC], rtol=1e-3)


def test_a_cells_lag_comes_back_with_stiffness_and_damping() -> None:
    """30 Hz; taken for a skew, it makes Bc wrong."""
    constant = 1.0 / (2.0 * np.pi * 30.0)
    torque = KC * steady_lag(MOTION.time, constant) + BC * steady_lag(MOTION.time, constant, 1) + NOISES
    found = identified("linear+offset+lag", torque)
    assert found["lag"] == pytest.approx(constant, rel=0.02)
    assert [found["Kc"], found["Bc"]] == pytest.approx([KC, BC], rel=0.02)
    assert fit(problem("linear+offset+skew", torque)).fitness > 1.01 * fit(problem("linear+offset+lag", torque)).fitness
    assert identified("linear+offset+skew", torque)["Bc"] < 0.9 * BC


@pytest.mark.study
def test_two_branches_come_back() -> None:
    parts = [MOTION.dtheta - steady_lag(MOTION.time, constant) for constant in (0.01, 0.2)]
    torque = spring_and_damper() + 0.15 * parts[0] + 0.1 * parts[1] + 0.1 * NOISES
    found = identified("linear+maxwell+maxwell2", torque)
    branches = sorted([(found["tau1"], found["K1"]), (found["tau2"], found["K2"])])
    assert found["Kc"] == pytest.approx(KC, rel=0.03)
    assert branches[1] == pytest.approx((0.2, 0.1), rel=0.15)


@pytest.mark.parametrize(("rise", "over"), [(0.0, 1.0), (1.0, 0.3), (0.5, 3.0)])
def test_friction_that_builds_up_is_that_of_an_integrator(rise: float, over: float) -> None:
    """Dahl's equation dz/dt = (v - |v| z)/reach, and LuGre's, in which z/(1 + rise exp(-(v/over)^2)) stands for z."""
    reach, rate = 0.02, CubicSpline(MOTION.time, MOTION.dtheta_dot)

    def building(t: float, z: Array) -> Array:
        v = float(rate(t))
        return np.asarray((v - abs(v) * z / (1.0 + rise * np.exp(-((v / over) ** 2)))) / reach)

    turns = [float(MOTION.time[0]), *rate.roots(extrapolate=False)[:10].tolist()]
    state, found = 0.0, []
    for start, stop in pairwise(turns):
        times = MOTION.time[(MOTION.time >= start) & (MOTION.time < stop)]
        solved = solve_ivp(building, (start, stop), [state], "LSODA", [*times, stop], rtol=1e-7, atol=1e-8)
        found += solved.y[0, :-1].tolist()
        state = float(solved.y[0, -1])
    # most where it turns between two samples
    errors = np.abs(MOTION.bristles(reach, rise, over)[: len(found)] - found)
    assert errors.mean() < 2e-3 * (1.0 + rise)
    assert errors.max() < 0.03 * (1.0 + rise)
    assert MOTION.bristles(reach, 0.0, over) == pytest.approx(MOTION.presliding(reach), abs=1e-8)


@pytest.mark.parametrize("law", [("presliding",), ("bristles", 0.5, 3.0), ("yielding",)])
@pytest.mark.parametrize("part", [0.1, pytest.param(1.0, marks=pytest.mark.study)])
def test_friction_that_builds_up_within_a_sample_is_that_of_one_sampled_50_times_finer(
    law: tuple[str, *tuple[float, ...]], part: float
) -> None:
    """Samples 4 ms apart, and a reach of a part of what the joint moves from one to the next (r.m.s.)."""
    fine = moving(np.linspace(0.0, 8.0, 100_001))
    motion = moving(fine.time[::50])
    reach = part * float(np.sqrt(np.mean(np.diff(motion.dtheta) ** 2)))
    exact, found = (getattr(one, law[0])(reach, *law[1:]) for one in (fine, motion))
    errors = np.abs(found - exact[::50])
    assert errors.mean() < 4e-3
    assert errors.max() < 0.12


def test_friction_forgets_how_it_began_over_the_way_there_and_back() -> None:
    """Samples so far apart that the joint turns between many of them. The second motion begins without friction."""
    motion = moving(np.linspace(0.0, 10.0, 401))
    later = moving(motion.time[150:])
    differ = motion.presliding(0.04)[150:] - later.presliding(0.04)
    assert differ == pytest.approx(differ[0] * later.fading(later.travelled, 0.04), abs=1e-9)


def test_a_spring_that_yields_is_that_of_an_integrator() -> None:
    """Bouc and Wen's dz/dx = (1 - (1/2 + sign(z dx)/2) |z|)/length, in steps 50 times finer."""
    length, last = 0.02, len(MOTION) - 1
    fine = np.interp(np.linspace(0.0, last, 50 * last + 1), np.arange(last + 1), MOTION.time)
    moves, load, found = np.diff(CubicSpline(MOTION.time, MOTION.dtheta)(fine)) / length, 0.0, [0.0]
    for move in moves.tolist():
        load += move * (1.0 - (0.5 + 0.5 * np.sign(move * load)) * abs(load))
        found.append(load)
    errors = np.abs(MOTION.yielding(length) - np.array(found)[::50])
    assert errors.mean() < 2e-3
    assert errors.max() < 0.03


@pytest.mark.parametrize("rest", [0.02, 1.5 * float(MOTION.dtheta.min())])
def test_friction_in_proportion_to_the_torque_comes_back(rest: float) -> None:
    """The torque carried is T = Kc (x - rest) + Bc v, and what is read T + mu |T| sign(v); never 0 under pretension."""
    carried = KC * (MOTION.dtheta - rest) + BC * MOTION.dtheta_dot
    torque = carried + 0.15 * np.abs(carried) * np.sign(MOTION.dtheta_dot) + 0.01 + NOISES
    found = identified("linear+offset+capstan", torque)
    expected = {"Kc": KC, "Bc": BC, "mu": 0.15, "rest": rest, "tau0": 0.01}
    assert found == pytest.approx(expected, rel=0.03, abs=1e-3)


@pytest.mark.study
@pytest.mark.parametrize("rest", [0.02, 1.5 * float(MOTION.dtheta.min())])
def test_a_damper_beside_a_pulley_adds_nothing_to_its_friction(rest: float) -> None:
    angle, rate = MOTION.dtheta, MOTION.dtheta_dot
    spring = KC * (angle - rest) + 60.0 * (angle - rest) ** 3
    damping = BC * rate + 2e-3 * rate * np.abs(rate)
    torque = spring + 0.15 * np.abs(spring) * np.sign(rate) + damping + 0.01 + NOISES
    found = identified("linear+offset+quadratic+cubic+pulley", torque)
    expected = {"Kc": KC, "Bc": BC, "B2": 2e-3, "K3": 60.0, "mu": 0.15, "rest": rest, "tau0": 0.01}
    assert found == pytest.approx(expected, rel=0.03, abs=1e-3)


def test_when_a_pulley_turns_its_friction_over_does_not_depend_on_the_damper() -> None:
    for term in ("pulley", "capstan"):
        model = parse(f"linear+offset+{term}").anchored(MOTION)
        at_once, late = (model.columns(MOTION, np.array([0.15, 0.0]), lag) for lag in (0.0, 0.02))
        assert np.array_equal(at_once, late) == (term == "pulley")


@pytest.mark.parametrize(
    ("term", "added"),
    [
        ("cubic", {"K3": 60.0}),
        pytest.param("quadratic", {"B2": 2e-3}, marks=pytest.mark.study),
        pytest.param("softening", {"Ks": 0.01}, marks=pytest.mark.study),
        pytest.param("maxwell", {"K1": 0.3, "tau1": 0.05}, marks=pytest.mark.study),
    ],
)
def test_a_tendon_rubs_in_proportion_to_all_that_it_carries(term: str, added: dict[str, float]) -> None:
    """A curve, a branch or another damping is part of the torque that its sheath takes mu of."""
    angle, rate, middle = MOTION.dtheta, MOTION.dtheta_dot, 0.5 * (MOTION.time[0] + MOTION.time[-1])
    more = {
        "cubic": 60.0 * angle**3,
        "quadratic": 2e-3 * rate * np.abs(rate),
        "softening": 0.01 * (MOTION.time - middle) * angle,
        "maxwell": 0.3 * (angle - steady_lag(MOTION.time, 0.05)),
    }
    carried = KC * angle + BC * rate + more[term]
    torque = carried + 0.15 * np.abs(carried) * np.sign(rate) + 0.01 + NOISES
    found = identified(f"linear+offset+{term}+capstan", torque)
    expected = {"Kc": KC, "Bc": BC, "mu": 0.15, "rest": 0.0, "tau0": 0.01} | added
    assert found == pytest.approx(expected, rel=0.05, abs=1e-3)


@pytest.mark.study
def test_a_tendon_rubs_beside_a_dead_band_in_which_only_its_damper_pulls() -> None:
    beyond = np.sign(MOTION.dtheta) * np.maximum(np.abs(MOTION.dtheta) - 0.01, 0.0)
    carried = KC * (beyond - 0.02) + BC * MOTION.dtheta_dot
    torque = carried + 0.15 * np.abs(carried) * np.sign(MOTION.dtheta_dot) + 0.01 + NOISES
    found = identified("linear+offset+deadband+capstan", torque)
    expected = {"Kc": KC, "Bc": BC, "gap": 0.02, "centre": 0.0, "mu": 0.15, "rest": 0.02, "tau0": 0.01}
    assert found == pytest.approx(expected, rel=0.03, abs=2e-3)


def built_up(reach: float, start: float) -> Array:
    """Dahl's state (n,) of the motion, from another one than zero, step by step through its interpolated deflection."""
    fine = np.interp(np.arange(50 * len(MOTION) - 49) / 50.0, np.arange(len(MOTION)), MOTION.time)
    level, found = start, [start]
    for move in np.diff(CubicSpline(MOTION.time, MOTION.dtheta)(fine)).tolist():
        level += (np.sign(move) - level) * (1.0 - np.exp(-abs(move) / reach))
        found.append(level)
    return np.array(found)[::50]


@pytest.mark.study
def test_friction_in_proportion_to_the_torque_that_builds_up_comes_back() -> None:
    carried = KC * (MOTION.dtheta - 0.02) + BC * MOTION.dtheta_dot
    torque = carried + 0.2 * np.abs(carried) * built_up(0.015, 0.7) + 0.01 + NOISES
    found = identified("linear+offset+sheath", torque)
    expected = {"Kc": KC, "Bc": BC, "mu": 0.2, "rest": 0.02, "tau0": 0.01, "reach": 0.015}
    assert found == pytest.approx(expected, rel=0.03, abs=1e-3)
    at_once = fit(problem("linear+offset+capstan", torque)).fitness
    assert at_once > 1.5 * fit(problem("linear+offset+sheath", torque)).fitness


@pytest.mark.parametrize("name", ["linear+offset+sheath", "linear+offset+backlash+gear"])
def test_a_load_that_remembers_is_that_of_all_samples_in_every_part_of_them(name: str) -> None:
    model, rows = parse(name).anchored(MOTION), slice(2000, 4000, 7)
    low, high = model.bounds(MOTION, highest=11.0)
    nonlinear = low + 0.3 * (high - low)
    assert np.array_equal(model.columns(MOTION.of(rows), nonlinear), model.columns(MOTION, nonlinear)[rows])


@pytest.mark.study
def test_friction_of_a_gear_that_grows_with_the_torque_beyond_its_play_comes_back() -> None:
    """Beyond half the gap flanks push with T = Kc x + Bc v, or part; the friction is (Fd + mu T) z, with Dahl's z."""
    beyond = MOTION.dtheta - np.clip(MOTION.dtheta, -0.01, 0.03)
    pushed = KC * beyond + BC * MOTION.dtheta_dot
    pushed = np.where(beyond * pushed > 0.0, pushed, 0.0)
    torque = pushed + (4e-3 + 0.3 * np.abs(pushed)) * built_up(0.01, 0.0) - 0.02 + NOISES
    found = identified("linear+offset+backlash+gear", torque)
    expected = {"Kc": KC, "Bc": BC, "Fd": 4e-3, "mu": 0.3, "gap": 0.04, "centre": 0.01, "tau0": -0.02, "reach": 0.01}
    assert found == pytest.approx(expected, rel=0.03, abs=5e-4)


def test_a_dead_band_whose_damper_always_acts_comes_back() -> None:
    beyond = MOTION.dtheta - 0.01
    sprung = np.sign(beyond) * np.maximum(np.abs(beyond) - 0.01, 0.0)
    torque = KC * sprung + BC * MOTION.dtheta_dot + NOISES
    found = identified("linear+offset+deadband", torque)
    assert (found["gap"], found["centre"]) == pytest.approx((0.02, 0.01), abs=1e-3)
    assert [found["Kc"], found["Bc"]] == pytest.approx([KC, BC], rel=0.01)
    worse = fit(problem("linear+offset+backlash", torque)).fitness
    assert worse > 1.5 * fit(problem("linear+offset+deadband", torque)).fitness


def test_a_stiffness_that_differs_between_the_directions_comes_back() -> None:
    beyond = MOTION.dtheta - 0.03
    torque = np.where(beyond > 0.0, 1.2, 0.8) * KC * beyond + BC * MOTION.dtheta_dot + NOISES
    found = identified("linear+offset+asymmetric", torque)
    assert [found[name] for name in ("Kc", "Ka", "Bc")] == pytest.approx([KC, 0.2 * KC, BC], rel=0.02)
    assert found["turn"] == pytest.approx(0.03, abs=2e-3)


def test_a_spring_that_curves_comes_back_with_its_stiffness_at_zero() -> None:
    x = MOTION.dtheta
    torque = KC * (x + x**2 - 3.0 * x**3 + 200.0 * x**5) + BC * MOTION.dtheta_dot + NOISES
    found = identified("linear+offset+cubic+quintic+progressive", torque)
    assert [found[name] / KC for name in ("Kc", "Kp", "K3", "K5")] == pytest.approx([1.0, 1.0, -3.0, 200.0], rel=0.05)


X, RATE, SECONDS = MOTION.dtheta, MOTION.dtheta_dot, MOTION.time - MOTION.time[0]
LAWS: dict[str, tuple[Callable[[], Array], dict[str, float], float]] = {
    "maxwell": (lambda: 0.1 * (X - steady_lag(MOTION.time, 0.03)), {"K1": 0.1, "tau1": 0.03}, 0.03),
    "quadratic": (lambda: 1e-3 * RATE * np.abs(RATE), {"B2": 1e-3}, 0.03),
    "boucwen": (lambda: 0.005 * MOTION.yielding(0.02), {"Fy": 0.005, "yield": 0.02}, 0.04),
    "dahl": (lambda: 0.005 * MOTION.presliding(0.02), {"Fd": 0.005, "reach": 0.02}, 0.04),
    # the first two terms of sinh-like tendons, whose torque is (e^(b|x|) - 1) Kc/b to either side
    "hardening": (lambda: 2.0 * KC * np.abs(X) * X, {"Kh": 2.0 * KC}, 0.02),
    # each of a pair pulls with (e^(|x|/s) - 1) Kc s, so that its stiffness rises by Kc/s in a radian at rest
    "exponential": (
        lambda: KC * (np.sign(X) * np.expm1(20.0 * abs(X)) / 20.0 - X),
        {"Kh": 10.0 * KC, "exponent": 20.0},
        0.02,
    ),
    "softening": (lambda: -0.2 * KC * (SECONDS / SECONDS[-1] - 0.5) * X, {"Ks": -0.2 * KC / SECONDS[-1]}, 0.01),
}
"""What a term adds to the torque of spring and damper, its parameters, and how well they come back."""


@pytest.mark.parametrize("term", LAWS)
def test_a_law_in_closed_form_comes_back_and_leaves_kc_and_bc_alone(term: str) -> None:
    added, expected, within = LAWS[term]
    found = identified(f"linear+{term}", spring_and_damper() + added() + NOISES)
    assert found == pytest.approx({"Kc": KC, "Bc": BC} | expected, rel=within)


@pytest.mark.parametrize("exponent", [20.0, -12.0])
def test_one_exponential_tendon_comes_back_whichever_way_it_pulls(exponent: float) -> None:
    x = MOTION.dtheta
    torque = KC / exponent * np.expm1(exponent * x) + BC * MOTION.dtheta_dot + 3e-3 + NOISES
    found = identified("linear+offset+toe", torque)
    expected = {"Kc": KC, "Bc": BC, "tau0": 3e-3, "Kp": 0.5 * KC * exponent, "exponent": exponent}
    assert found == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("term", "steady"), [("exponential", "hardening"), ("toe", "progressive")])
@pytest.mark.parametrize("exponent", [0.0, 1e-6])
def test_an_exponent_of_zero_is_a_stiffness_that_rises_steadily(term: str, steady: str, exponent: float) -> None:
    rising, plain = (parse(f"linear+offset+{name}").anchored(MOTION) for name in (term, steady))
    found = rising.columns(MOTION, np.array([exponent]))[:, 3]
    assert found == pytest.approx(plain.columns(MOTION)[:, 3], rel=1e-5, abs=1e-12)


def test_friction_that_falls_with_the_rate_comes_back_and_leaves_bc_alone() -> None:
    rate = MOTION.dtheta_dot
    fallen = np.exp(-((rate / 0.3) ** 2))
    torque = spring_and_damper() + 3e-3 * np.tanh(rate / 1e-2) * (1.0 + 0.6 * fallen) + NOISES
    found = identified("linear+coulomb+stribeck", torque)
    assert [found[name] for name in ("Kc", "Bc")] == pytest.approx([KC, BC], rel=0.01)
    assert [found[name] for name in ("Fc", "Fs", "vst")] == pytest.approx([3e-3, 1.8e-3, 0.3], rel=0.15)


@pytest.mark.parametrize("over", [0.1, 0.3, 1.0])
def test_friction_that_turns_smoothly_comes_back_and_leaves_bc_alone(over: float) -> None:
    torque = spring_and_damper() + 3e-3 * np.tanh(MOTION.dtheta_dot / over) + NOISES
    found = identified("linear+coulomb+smooth", torque)
    assert [found[name] for name in ("Kc", "Bc")] == pytest.approx([KC, BC], rel=0.01)
    assert [found[name] for name in ("Fc", "vr")] == pytest.approx([3e-3, over], rel=0.05)


def test_the_derivative_by_a_build_up_is_as_right_where_the_joint_moves_by_a_few_microradians() -> None:
    """A motion and a build-up of a millionth of the size: the friction is the same, its derivative a million times."""
    scale, reach, genes = 1e-6, np.array([2e-4]), np.array([0.0, 0.0, 1.0])
    angle, rate, acceleration = (scale * one for one in (MOTION.dtheta, MOTION.dtheta_dot, MOTION.dtheta_ddot))
    small, model = Motion(MOTION.time, angle, rate, acceleration, MOTION.known), parse("linear+dahl")
    slopes = [model.anchored(one).jacobian(one, reach * size, genes) for one, size in ((MOTION, 1.0), (small, scale))]
    np.testing.assert_allclose(scale * slopes[1], slopes[0], rtol=1e-6, atol=1e-6 * np.abs(slopes[0]).max())


@pytest.mark.parametrize(("order", "hidden"), [(1, True), (2, False), (0, False)])
def test_friction_is_hidden_behind_a_drive_of_first_order_between_two_places(order: int, *, hidden: bool) -> None:
    """Order 0: a triangle, where friction is damping and no stiffness; of second order, it has another torque."""
    step, period, omega, time = 2e-3, 0.5, 20.0, np.arange(4000) / 500.0
    since, up = time % period, 1.0 - 2.0 * (np.floor(time / period) % 2.0)
    left = np.exp(-omega * since) * (1.0 + omega * since if order == 2 else 1.0)
    place = up * (1.0 - 2.0 * left)
    rate = 2.0 * up * omega * np.exp(-omega * since) * (omega * since if order == 2 else 1.0)
    if order == 0:
        place, rate = up * (2.0 * since / period - 1.0), 2.0 * up / period
    motion = Motion(time, 0.2 * place, 0.2 * rate, np.gradient(0.2 * rate, step), np.zeros(len(time)))
    assert is_hidden(motion) == hidden


@pytest.mark.parametrize(
    ("damping", "lag", "places", "hidden"),
    [
        (1.0, 0.0, (-0.2, 0.2), True),
        (1.0, 0.03, (-0.2, 0.2), True),
        (0.6, 0.0, (-0.2, 0.2), False),
        (1.0, 0.0, (-0.2, 0.0, 0.2), False),
    ],
)
def test_friction_is_a_stiffness_and_an_inertia_behind_a_drive_that_does_not_overshoot(
    damping: float, lag: float, places: tuple[float, ...], *, hidden: bool
) -> None:
    """Random steps to two places every 0.1 s, through a drive of 8 Hz and a lag; not with overshoot or a third one."""
    fine, omega = 2.5e-4, 2.0 * np.pi * 8.0
    command = np.repeat(np.random.default_rng(3).choice(places, 200), 400)
    (ahead,), back, _ = cont2discrete(([omega**2], [1.0, 2.0 * damping * omega, omega**2]), fine)
    place = lfilter(ahead, back, command)
    if lag:
        (ahead,), back, _ = cont2discrete(([1.0], [lag, 1.0]), fine)
        place = lfilter(ahead, back, place)
    rate = np.gradient(place, fine)
    ticks = slice(None, None, 10)
    acceleration = np.gradient(rate, fine)[ticks]
    time = np.arange(8000) / 400.0
    motion = Motion(time, place[ticks], rate[ticks], acceleration, np.zeros(8000), rate_noise=1e-3)
    assert is_hidden(motion, inertia=True) == hidden


def test_a_joint_rests_where_most_moves_end_in_rest_and_not_where_some_are_slow() -> None:
    """A logarithmic chirp from 0.2 to 12 Hz is slow around the turning points of its slow end."""
    time, omega = np.arange(10_000) / 500.0, 40.0
    since, up = time % 0.2, 1.0 - 2.0 * (np.floor(time / 0.2) % 2.0)
    binary = up * (1.0 - 2.0 * np.exp(-omega * since) * (1.0 + omega * since))
    chirp = np.sin(2.0 * np.pi * 0.2 * 20.0 / np.log(60.0) * (60.0 ** (time / 20.0) - 1.0))
    for place, rests in ((binary, True), (chirp, False)):
        rate = np.gradient(0.3 * place, time)
        motion = Motion(time, 0.3 * place, rate, np.gradient(rate, time), np.zeros(len(time)))
        assert looks_like_spring(motion) == rests
