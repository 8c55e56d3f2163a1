from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.coupling import parse
from ga.model.terms import TERMS, UnknownTerm, compatible_model, lacking
from ga.model.trajectory import Motion

Array = NDArray[np.float64]

TIME = np.linspace(1.7e9, 1.7e9 + 4.0, 401)
DTHETA = 0.2 * np.sin(2.0 * (TIME - TIME[0]))
RATE = 0.4 * np.cos(2.0 * (TIME - TIME[0]))
ACCELERATION = -0.8 * np.sin(2.0 * (TIME - TIME[0]))
MOTION = Motion(TIME, DTHETA, RATE, ACCELERATION, np.zeros(401))


def moving(scale: float = 1.0, rate_noise: float | None = None) -> Motion:
    return Motion(TIME, scale * DTHETA, scale * RATE, scale * ACCELERATION, np.zeros(401), rate_noise=rate_noise)


def test_the_linear_model_is_equation_3() -> None:
    columns = parse("linear").columns(MOTION)
    assert np.array_equal(columns, np.stack([DTHETA, RATE], axis=1))


def test_the_order_of_the_terms_does_not_matter() -> None:
    one, other = parse("coulomb + linear+offset"), parse("linear+offset+coulomb")
    assert one == other
    assert one.name == "linear+offset+coulomb"
    assert parse("linear+offset+smooth+pulley").name == "linear+offset+pulley+smooth"
    assert [p.name for p in one.parameters] == ["Kc", "Bc", "tau0", "Fc"]


def test_every_term_names_its_parameters_with_their_units_in_the_order_of_the_columns() -> None:
    model = parse("linear+offset+drift+coulomb+cubic+inertia")
    assert [(p.name, p.unit) for p in model.parameters] == [
        ("Kc", "N*m/rad"),
        ("Bc", "N*m*s/rad"),
        ("tau0", "N*m"),
        ("drift", "N*m/s"),
        ("Fc", "N*m"),
        ("K3", "N*m/rad^3"),
        ("J", "kg*m^2"),
    ]
    columns = model.columns(MOTION)
    assert columns.shape == (401, 7)
    assert np.array_equal(columns[:, 2], np.ones(401))
    assert np.array_equal(columns[:, 3], TIME - TIME[0])
    assert columns[:, 5] == pytest.approx(DTHETA**3, rel=1e-14)
    assert np.array_equal(columns[:, 6], ACCELERATION)


WITHOUT_MEMORY = [name for name, term in TERMS.items() if term.columns is not None and "/dt = " not in term.equation]


def test_the_equation_of_a_term_names_every_parameter() -> None:
    for term in TERMS.values():
        assert {parameter.name for parameter in term.parameters} <= set(re.findall(r"[A-Za-z]\w*", term.equation))


@pytest.mark.parametrize("name", WITHOUT_MEMORY)
def test_the_equation_of_a_term_is_the_torque_that_it_adds(name: str) -> None:
    model, term = parse(compatible_model(name, ())), TERMS[name]
    values = {parameter.name: 0.3 + 0.2 * at for at, parameter in enumerate(model.parameters)}
    signs = {"x": DTHETA, "v": RATE, "t": TIME - TIME[0], "tm": 2.0, "acceleration": ACCELERATION}
    signs |= {"sign": np.sign, "exp": np.exp, "abs": np.abs}

    def evaluated(equation: str) -> Array:
        code = re.sub(r"\|([^|]*)\|", r"abs(\1)", equation).replace("^", "**").replace("dv/dt", "acceleration")
        return np.asarray(eval(code, {}, signs | values))  # noqa: S307 - the record of a term

    torque, _, where = term.equation.partition(", ")
    if where.startswith("u = "):
        signs["u"] = evaluated(where.removeprefix("u = "))
    columns = model.columns(MOTION, np.array([values[one.name] for one in model.nonlinear]))
    own = [one.name in {parameter.name for parameter in term.parameters} for one in model.linear]
    given = np.array([values[one.name] for one in model.linear])
    moving = np.abs(RATE) > 0.1  # where friction has its sign
    np.testing.assert_allclose(
        (columns[:, own] @ given[own])[moving], np.broadcast_to(evaluated(torque), 401)[moving], rtol=1e-6, atol=1e-9
    )


def test_coulomb_friction_is_a_sign_smoothed_where_the_joint_hardly_moves() -> None:
    friction = parse("linear+coulomb").columns(MOTION)[:, 2]
    moving = np.abs(RATE) > 0.1
    assert friction[moving] == pytest.approx(np.sign(RATE[moving]), abs=1e-3)
    assert np.all(np.diff(friction[np.argsort(RATE)]) >= 0.0)


def test_the_smoothing_follows_the_scale_of_the_rate() -> None:
    model = parse("linear+coulomb")
    slow = model.columns(moving(1e-4))[:, 2]
    assert slow == pytest.approx(model.columns(MOTION)[:, 2], rel=1e-9)


def test_a_joint_that_never_moved_has_no_coulomb_column() -> None:
    columns = parse("linear+coulomb").columns(moving(0.0))
    assert not columns[:, 2].any()


def test_an_unknown_term_is_answered_with_the_known_ones_and_the_nearest() -> None:
    with pytest.raises(UnknownTerm, match=r'no model term "coulom": did you mean "coulomb"\? there are linear, offset'):
        parse("linear+coulom")


def test_friction_says_nothing_of_the_slowest_samples_and_is_a_sign_of_the_others() -> None:
    model = parse("linear+coulomb").anchored(MOTION)
    used = model.described(MOTION)
    assert np.mean(~used) == pytest.approx(0.075, abs=0.005)
    assert np.abs(RATE[~used]).max() <= np.abs(RATE[used]).min()
    assert np.all(np.abs(model.columns(MOTION)[used, 2]) > 0.999)
    assert parse("linear+skew").anchored(MOTION).described(MOTION).all()


def test_the_slowest_samples_are_those_of_when_the_torque_was_read() -> None:
    model = parse("linear+coulomb+skew").anchored(MOTION)
    used = model.described(MOTION, 0.03)
    late = MOTION.delayed(0.03).dtheta_dot
    assert np.all(np.abs(late[used]) >= model.slowest)
    turned = np.abs(MOTION.delayed(0.0325).dtheta_dot) < model.slowest  # a quarter of the time between two samples
    assert not used[turned].any()
    assert not np.array_equal(used, model.described(MOTION))


def test_where_noise_hides_which_samples_are_slow_none_is_left_out() -> None:
    noise = 2.0 * float(np.quantile(np.abs(RATE), 0.075))
    assert parse("linear+coulomb").anchored(moving(rate_noise=noise)).described(MOTION).all()


@pytest.mark.parametrize("rest", [0, 40])
def test_where_the_joint_comes_to_rest_friction_is_a_sign_in_every_sample_that_is_described(rest: int) -> None:
    """A fifth of the samples are slower than the sign is smoothed, and no noise hides which ones.

    Nor beside a rest that is longer than any slow motion.
    """
    dying = np.where(np.arange(401) % 100 < rest, 0.0, np.geomspace(1.0, 1e-6, 401) * np.sign(RATE))
    motion = replace(moving(rate_noise=1e-9), dtheta_dot=dying)
    model = parse("linear+coulomb").anchored(motion)
    used = model.described(motion)
    assert np.abs(model.columns(motion)[used, 2]).min() > 0.99
    assert used[np.abs(dying) > 0.01].all()


@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_friction_says_nothing_of_samples_in_which_the_rate_turns_before_the_joint(delay: float) -> None:
    """The joint comes up slowly and is thrown back; a window of eleven samples sees it go back five samples early."""
    place = np.arange(401) % 100
    angle = np.where(place < 60, 2e-3 * place, 0.12 - 0.04 * np.minimum(place - 60, 3))
    rate = np.convolve(np.gradient(angle, 0.01), np.full(11, 1.0 / 11.0), mode="same")
    motion = replace(moving(rate_noise=1e-6), dtheta=angle, dtheta_dot=rate)
    model = parse("linear+coulomb+skew" if delay else "linear+coulomb").anchored(motion)
    used = model.described(motion, delay)
    late = round(delay / 0.01)
    early = np.roll((place >= 55) & (place < 60) & (rate < 0.0), late)
    assert np.count_nonzero(early) >= 16
    assert np.count_nonzero(used & early) == 0
    assert used[np.roll((place > 20) & (place < 50), late)].all()


@pytest.mark.parametrize(("noise", "found"), [(0.001, 1.0), (0.004, 0.97), (0.006, 0.97), (0.012, 0.97)])
def test_noise_that_leaves_most_rates_known_does_not_hide_where_the_joint_rests(noise: float, found: float) -> None:
    rests = np.arange(len(RATE)) % 100 < 30
    noise *= float(np.sqrt(np.mean(RATE[~rests] ** 2)))
    resting = np.where(rests, noise * np.random.default_rng(0).standard_normal(len(RATE)), RATE)
    motion = replace(moving(rate_noise=noise), dtheta_dot=resting)
    used = parse("linear+coulomb").anchored(motion).described(motion)
    assert np.mean(~used[rests]) >= found
    assert np.mean(used[~rests]) > 0.9


@dataclass(frozen=True)
class Mean:
    """A filter: the mean of so many readings on each side."""

    half: int
    longest_step: float = 0.0

    def of_every(self, _every: int) -> Mean:
        return self

    def passing(self, _time: Array) -> Callable[[Array], Array]:
        def passed(values: Array) -> Array:
            padded = np.pad(values, self.half, mode="edge")
            return np.convolve(padded, np.full(2 * self.half + 1, 1.0 / (2 * self.half + 1)), mode="valid")

        return passed


def test_a_filter_brings_friction_of_unknown_size_from_a_rest_but_not_from_a_reversal() -> None:
    resting = np.where((RATE > 0.0) & (TIME - TIME[0] > 2.0), 0.0, RATE)
    motion = replace(moving(rate_noise=1e-3), dtheta_dot=resting)
    model = parse("linear+coulomb").anchored(motion)
    plain = model.described(motion)
    seen = model.described(replace(motion, behind=Mean(20)))
    near = np.convolve(resting == 0.0, np.ones(41), mode="same") > 0.5  # 20 samples on each side of the rest
    assert not seen[near].any()
    assert plain[near & (resting != 0.0)].any()
    far = np.convolve(resting == 0.0, np.ones(61), mode="same") < 0.5
    assert np.array_equal(seen[far], plain[far])
    assert (~plain[far]).any()  # at a reversal


@pytest.mark.parametrize(("noise", "smoothing"), [(0.01, 0.005), (1e-9, 1e-3), (1.0, 0.05)])
def test_the_sign_of_friction_is_as_soft_as_the_noise_of_the_rate(noise: float, smoothing: float) -> None:
    """At least a thousandth and at most a twentieth of the r.m.s. rate."""
    usual = np.sqrt(np.mean(RATE**2))
    model = parse("linear+coulomb").anchored(moving(rate_noise=noise))
    assert model.smoothing == pytest.approx(smoothing if noise == 0.01 else smoothing * usual)


@pytest.mark.parametrize(
    ("term", "parameters"), [("backlash", ["gap", "centre"]), ("slack", ["slack"]), ("skew", ["skew"])]
)
def test_a_term_that_shapes_the_columns_adds_none(term: str, parameters: list[str]) -> None:
    model = parse(f"linear+offset+{term}")
    assert [p.name for p in model.linear] == ["Kc", "Bc", "tau0"]
    assert [p.name for p in model.nonlinear] == parameters
    assert model.columns(MOTION, np.full(len(parameters), 0.01)).shape == (401, 3)


def test_a_gap_lets_the_joint_move_without_torque() -> None:
    """A gap of 0.1 rad about 0.02 rad."""
    columns = parse("linear+backlash").columns(MOTION, np.array([0.1, 0.02]))
    beyond = DTHETA - 0.02
    free = np.abs(beyond) <= 0.05
    assert not columns[free].any()
    assert columns[~free, 0] == pytest.approx(beyond[~free] - 0.05 * np.sign(beyond[~free]))
    assert np.array_equal(columns[~free, 1], RATE[~free])


def test_flanks_that_damping_would_make_pull_let_go() -> None:
    """With Bc/Kc = 0.1 s the torque on a flank is that of the spring and the damper, or none: never of other sign."""
    columns = parse("linear+backlash").columns(MOTION, np.array([0.1, 0.0]), lag=0.1)
    torque = columns @ np.array([1.0, 0.1])
    outside = np.sign(DTHETA) * np.maximum(np.abs(DTHETA) - 0.05, 0.0)
    expected = outside + 0.1 * RATE
    expected[(outside == 0.0) | (np.sign(expected) != np.sign(outside))] = 0.0
    assert torque == pytest.approx(expected)
    assert np.count_nonzero((outside != 0.0) & (torque == 0.0)) > 10


def test_a_slack_tendon_pulls_one_way_only() -> None:
    columns = parse("linear+slack").columns(MOTION, np.array([-0.05]))
    loose = DTHETA <= -0.05
    assert not columns[loose].any()
    assert columns[~loose, 0] == pytest.approx(DTHETA[~loose] + 0.05)


def test_skew_is_how_much_older_the_torque_is_than_the_angle() -> None:
    """The torque reading shows the angle as it was; the closed form is the same sine, earlier."""
    columns = parse("linear+skew").columns(MOTION, np.array([0.03]))  # stamps of today resolve 0.2 us
    then = 2.0 * (TIME - TIME[0] - 0.03)
    inner = slice(10, -10)
    assert columns[inner, 0] == pytest.approx(0.2 * np.sin(then)[inner], abs=1e-6)
    assert columns[inner, 1] == pytest.approx(0.4 * np.cos(then)[inner], abs=1e-6)


def test_what_is_known_of_the_torque_is_as_old_as_the_rest_of_it() -> None:
    motion = Motion(TIME, DTHETA, RATE, ACCELERATION, 3.0 * ACCELERATION)
    left = parse("linear+skew").target(motion, np.zeros(401), np.array([0.03]))
    assert left[10:-10] == pytest.approx(2.4 * np.sin(2.0 * (TIME - TIME[0] - 0.03))[10:-10], abs=1e-6)


def test_the_slope_of_a_gap_is_half_the_stiffness_on_either_flank() -> None:
    slopes = parse("linear+backlash").jacobian(MOTION, np.array([0.1, 0.0]), np.array([2.0, 0.1]))
    assert set(np.unique(slopes[:, 0])) == {-1.0, 0.0, 1.0}
    assert np.array_equal(slopes[:, 1], np.where(np.abs(DTHETA) > 0.05, -2.0, 0.0))
    assert np.array_equal(slopes[:, 0], np.where(np.abs(DTHETA) > 0.05, -np.sign(DTHETA), 0.0))


def test_a_skew_is_looked_for_within_a_quarter_of_the_shortest_period() -> None:
    low, high = parse("linear+skew").bounds(MOTION, highest=50.0)
    assert (low[0], high[0]) == (-0.005, 0.005)
    ticks = float(np.median(np.diff(MOTION.time)))
    assert parse("linear+skew").bounds(MOTION, highest=0.1)[1][0] == pytest.approx(10.0 * ticks)
    faster = replace(MOTION, time=0.01 * MOTION.time)
    assert parse("linear+skew").bounds(faster, highest=0.1)[1][0] == 0.02


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("linear+backlash+slack", "no second flank"),
        ("linear+offset+offset", "offset is named twice"),
        ("offset", "begins with linear"),
        ("linear+offset+smooth", "smooth changes a friction, and .* has none: add coulomb, capstan or pulley"),
    ],
)
def test_terms_that_do_not_go_together_are_refused(name: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        parse(name)


def test_vectors_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="differ in shape"):
        Motion(TIME, DTHETA[:-1], RATE, ACCELERATION, np.zeros(401))


def test_an_anchored_model_is_one_model_for_every_part_of_the_data() -> None:
    model = parse("linear+drift+coulomb")
    whole = model.columns(MOTION)
    anchored = model.anchored(MOTION)
    parts = [anchored.columns(MOTION.of(part)) for part in (slice(0, 90), slice(90, None))]
    assert np.array_equal(np.concatenate(parts), whole)
    assert not np.array_equal(model.columns(MOTION.of(slice(90, None))), whole[90:])


def test_columns_without_nonlinear_parameters_are_those_of_the_samples_of_a_part() -> None:
    part = MOTION.of(slice(1, None, 7))
    for term in set(TERMS) - {"linear"}:
        model = parse(compatible_model(term, ["linear", "offset"])).anchored(MOTION)
        assert np.array_equal(model.columns(part), model.columns(MOTION)[1::7]), term
        assert model.target(part, np.ones(len(part))).shape == (len(part),)


def test_a_term_that_is_advised_makes_a_model_with_what_it_needs_whatever_the_model_was() -> None:
    models = ("linear", "linear+slack", "linear+offset+dahl+backlash", "linear+offset+coulomb+stribeck+capstan+lag")
    for term, name in product(set(TERMS) - {"linear"}, models):
        advised = parse(compatible_model(term, name.split("+"))).name.split("+")
        assert {"linear", term, lacking(term, advised) or term} <= set(advised)


def test_friction_that_turns_smoothly_holds_no_joint() -> None:
    slow = Motion(TIME, DTHETA, np.where(np.arange(len(TIME)) % 9 == 0, 0.0, RATE), ACCELERATION, np.zeros(len(TIME)))
    assert not parse("linear+coulomb").described(slow).all()
    assert parse("linear+coulomb+smooth").described(slow).all()


def test_a_rarer_law_takes_with_the_friction_in_its_place_what_only_that_needs() -> None:
    terms = ("linear", "offset", "coulomb", "stribeck", "smooth", "skew")
    assert compatible_model("dahl", terms) == "linear+offset+dahl+skew"
