"""Kc and Bc averaged over models: a small skew that model selection leaves out is in their intervals."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import parse
from ga.model.separable import Problem, fit
from hil.identification.candidates.choice import Choice, choose
from hil.identification.candidates.criterion import by_rate, density_at_zero
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import covariance
from hil.identification.identify import identify
from hil.identification.mixture import average, hidden, largest
from hil.identification.mixture.average import Averaged
from hil.identification.mixture.largest import Largest, Selected, largest_model
from hil.identification.result import Step
from hil.recording.reader import Array, Recording
from hil.report.identification_json import as_json
from hil.signals.prepare import prepare

from ..conftest import Maker
from .chirps import building_up, chirp, signals
from .conftest import SEARCH

KC, BC = 0.0178, 1.9e-4


def sweep(channels: dict[str, Array], skew: float, seed: int) -> None:
    """Three sines up to 9 Hz with 0.2 mN m of noise on a torque that is `skew` seconds older than the angle."""
    time, noise = channels["time"], np.random.default_rng(seed).standard_normal(len(channels["time"]))

    def motion(at: Array) -> tuple[Array, Array]:
        waves = [(0.2, 2.0), (0.1, 15.0), (0.05, 57.0)]
        angle = sum((a * np.sin(w * at + w) for a, w in waves), start=np.zeros_like(at))
        return angle, sum((a * w * np.cos(w * at + w) for a, w in waves), start=np.zeros_like(at))

    channels["dtheta"], channels["dtheta_dot"] = motion(time)
    angle, rate = motion(time - skew)
    channels["torque"] = KC * angle + BC * rate + 2e-4 * noise


@pytest.mark.study
@pytest.mark.parametrize("skew", [0.0, 1e-4])
def test_the_interval_of_the_damping_holds_it_beside_a_skew_that_is_not_significant(
    make_recording: Maker, skew: float
) -> None:
    """4 recordings of the same joint: of intervals that hold 95 %, 3 or more do in 98.6 of 100 such tests."""
    held, widths = [], []
    for seed in range(4):
        path = make_recording(f"{seed}.h5", change=lambda channels, seed=seed: sweep(channels, skew, seed))
        bc = identify([path], None, SEARCH)["Bc"]
        held.append(bc.ci95[0] <= BC <= bc.ci95[1])
        assert bc.conditional is not None
        widths.append((bc.ci95[1] - bc.ci95[0]) / (bc.conditional.ci95[1] - bc.conditional.ci95[0]))
    assert sum(held) >= 3
    assert np.median(widths) < 2.5


@pytest.mark.parametrize(
    ("seed", "model"),
    [
        (0, None),
        pytest.param(1, "linear+offset+coulomb", marks=pytest.mark.study),
        pytest.param(2, None, marks=pytest.mark.study),
        pytest.param(3, None, marks=pytest.mark.study),
    ],
)
def test_value_exact_optimum_and_interval_agree_whatever_the_joint(
    make_recording: Maker, seed: int, model: str | None
) -> None:
    """Joints, noise, friction and skew drawn at random: stiffness over four decades, damping down to nothing."""
    rng = np.random.default_rng(seed)
    kc, corner = 10.0 ** rng.uniform(-2.0, 2.0), rng.uniform(0.0, 0.05)
    friction, noise, skew = rng.uniform(0.0, 0.1, 3) * [1.0, 1.0, 0.02]

    def drawn(channels: dict[str, Array]) -> None:
        sweep(channels, skew, seed)
        angle, rate = channels["dtheta"], channels["dtheta_dot"]
        pure = kc * (angle + corner * rate - skew * rate)
        size = float(np.std(pure))
        channels["torque"] = pure + size * (friction * np.sign(rate) + noise * rng.standard_normal(len(rate)))

    found = identify([make_recording(samples=1200, change=drawn)], None if model is None else parse(model), SEARCH)
    for said in as_json(found)["parameters"].values():
        for one in (said, said["conditional"]):
            if one["ci95"][0] is not None:
                assert one["value"] == pytest.approx(0.5 * sum(one["ci95"]), abs=1e-9 * max(map(abs, one["ci95"])))
        low, high = said["ci95"]
        if model is not None:  # a named model keeps its own interval
            assert (said["value"], said["ci95"]) == (said["conditional"]["value"], said["conditional"]["ci95"])
        elif low is not None:
            assert said["choice_share"] == pytest.approx(1.0 - np.ptp(said["conditional"]["ci95"]) / (high - low))
        assert low is None or low <= said["conditional"]["value"] <= high or said["choice_share"] > 0.0
        trial, exact = said["optimiser_repeatability"]["best"], said["conditional"]["value"]
        assert trial == pytest.approx(exact, rel=0.01, abs=0.1 * (high - low) if low is not None else np.inf)
    included = [step for step in found.steps if step.included]
    if included:
        assert (included[-1].Kc, included[-1].Bc) == (found["Kc"].exact, found["Bc"].exact)
    signals, model_used = found.signals, found.model
    if not model_used.nonlinear and found.samples == len(signals):
        columns = model_used.columns(signals.motion)
        error = signals.torque - columns @ np.array([one.exact for one in found.estimates])
        assert found.optimum == pytest.approx(float(np.mean(np.abs(error))), rel=1e-9)
        assert found.optimum <= found.fitness
    if found.trusted("Bc"):
        assert found["Bc"].value > 0.0


@pytest.mark.study
def test_a_skew_of_more_than_a_tick_is_said_to_be_none_of_a_recorder(make_recording: Maker) -> None:
    path = make_recording(samples=1000, change=lambda channels: sweep(channels, 5e-3, 1))
    found = identify([path], parse("linear+skew"), SEARCH)
    assert "torque-reading" in [one.code for one in found.diagnostics]


@pytest.mark.parametrize(("delayed", "rows"), [pytest.param(True, 4000, marks=pytest.mark.study), (False, 465)])
def test_a_named_skew_that_no_recorder_has_is_an_error_where_another_cause_explains_the_torque_as_well(
    make_recording: Maker, delayed: bool, rows: int
) -> None:
    def change(channels: dict[str, Array]) -> None:
        sweep(channels, 5e-3 if delayed else 0.0, 1)
        if not delayed:  # an inertia, which the model lacks, looks like an early reading
            channels["torque"] += 2e-6 * np.gradient(channels["dtheta_dot"], channels["time"])

    found = identify([make_recording(samples=rows, change=change)], parse("linear+offset+skew"), SEARCH)
    said = [one for one in found.diagnostics if one.code == "torque-reading"]
    assert [one.is_error for one in said] == [not delayed]
    assert delayed or abs(found["Bc"].value / BC - 1.0) > 0.1


@pytest.mark.study
def test_a_branch_that_relaxes_faster_than_the_joint_moves_does_not_make_the_damping_sure(
    make_recording: Maker,
) -> None:
    """Beside 0.8 ms of delay it is taken for more of it: the damping is not sure to a few per cent, whoever fits it."""
    branch, constant, late = 0.9 * KC, 1.5e-3, 8e-4

    def relaxing(channels: dict[str, Array]) -> None:
        time, noise = channels["time"], np.random.default_rng(3).standard_normal(len(channels["time"]))
        waves = [(0.2, 2.0), (0.1, 15.0), (0.05, 57.0)]
        stiffness = [KC + 1j * w * BC + branch * 1j * w * constant / (1.0 + 1j * w * constant) for _, w in waves]
        torque = [a * k * np.exp(1j * w * (time - late)) for (a, w), k in zip(waves, stiffness, strict=True)]
        channels["dtheta"] = np.sum([a * np.sin(w * time) for a, w in waves], axis=0)
        channels["dtheta_dot"] = np.sum([a * w * np.cos(w * time) for a, w in waves], axis=0)
        channels["torque"] = np.sum(torque, axis=0).imag + 1e-5 * noise

    found = identify([make_recording(samples=1000, rate=250.0, change=relaxing)], None, SEARCH)
    bc, damper = found["Bc"], BC + branch * constant
    assert abs(bc.value - damper) < 0.75 * (bc.ci95[1] - bc.ci95[0]) or not found.trusted("Bc")
    assert bc.conditional is not None
    assert bc.ci95[1] - bc.ci95[0] > 3.0 * (bc.conditional.ci95[1] - bc.conditional.ci95[0])


@pytest.mark.study
def test_a_weak_branch_that_looks_like_a_short_delay_leaves_bc_in_its_interval(make_recording: Maker) -> None:
    """A tenth of Kc that relaxes in 10 ms looks 0.6 ms late; a model with a skew has Bc 13 % too high."""
    rng = np.random.default_rng(1)
    speeds = 2.0 * np.pi * np.geomspace(0.3, 12.0, 15)
    stiffness = 0.3 + 1j * speeds * 3e-3 + 0.03 * 1j * speeds * 0.01 / (1.0 + 1j * speeds * 0.01)

    def relaxing(channels: dict[str, Array]) -> None:
        waves = 0.03 * np.exp(1j * (np.outer(channels["time"], speeds) + rng.uniform(0.0, 2.0 * np.pi, 15)))
        channels["dtheta"] = waves.sum(axis=1).imag
        channels["torque"] = (waves * stiffness).sum(axis=1).imag + 1.5e-3 * rng.standard_normal(len(waves))

    found = identify([make_recording(samples=5000, change=relaxing)], None, SEARCH)
    low, high = found["Bc"].ci95
    assert low < 3e-3 < high


@pytest.mark.study
def test_a_skew_that_chance_may_have_made_leaves_the_damping_without_it_in_the_interval(make_recording: Maker) -> None:
    """It is 0.9 ms with a standard error of 0.3, of which 0.5 are there, and every recorder has a tenth of a tick."""
    path = make_recording(change=lambda channels: sweep(channels, 5e-4, 1))
    found = identify([path], None, SEARCH)
    assert "skew" in found.model.name
    without = identify([path], parse("linear"), SEARCH)["Bc"].value
    low, high = found["Bc"].ci95
    assert low < without < high


@pytest.mark.study
@pytest.mark.parametrize("form", ["capstan", "backlash"])
def test_averages_are_held_against_the_values_of_the_fit_whatever_its_columns_depend_on(
    make_recording: Maker, form: str
) -> None:
    """Flanks part where Bc/Kc says, and friction in proportion to the load weighs the residuals."""

    def change(channels: dict[str, Array]) -> None:
        sweep(channels, 0.0, 1)
        angle, rate = channels["dtheta"], channels["dtheta_dot"]
        noise, beyond = channels["torque"] - KC * angle - BC * rate, angle - np.clip(angle, -0.02, 0.02)
        pushed, carried = KC * beyond + BC * rate, KC * angle + BC * rate
        gap, rubbing = np.where(beyond * pushed > 0.0, pushed, 0.0), carried + 0.15 * np.abs(carried) * np.sign(rate)
        channels["torque"] = noise + (gap if form == "backlash" else rubbing)

    with Recording(make_recording(change=change)) as recording:
        signals = prepare(recording, None)
    model = parse(f"linear+offset+{form}").anchored(signals.motion)
    bounds = model.bounds(signals.motion, signals.band[1])
    found = fit(Problem(model, signals.motion, signals.torque, *bounds))
    own = Selected(model, found.nonlinear, signals).values
    assert list(own.values()) == pytest.approx(found.optimum.genes.tolist(), rel=1e-6, abs=1e-9)


@pytest.mark.study
@pytest.mark.parametrize("form", ["gap", "drift"])
def test_the_interval_of_kc_holds_an_unevenness_of_the_spring_that_noise_hides(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    """A gap of 1.2 % of the stroke, or a stiffness that drifts by 3 %."""

    def change(channels: dict[str, Array]) -> None:
        sweep(channels, 0.0, 3)
        angle, time = channels["dtheta"], channels["time"]
        noise = 2.0 * (channels["torque"] - KC * angle - BC * channels["dtheta_dot"])
        beyond = np.sign(angle) * np.maximum(np.abs(angle) - 0.004, 0.0)
        spring = beyond if form == "gap" else angle * (1.0 + 0.03 * (time / time[-1] - 0.5))
        channels["torque"] = KC * spring + BC * channels["dtheta_dot"] + noise

    path = make_recording("uneven.h5", change=change)
    kc = identify([path], None, SEARCH)["Kc"]
    assert kc.ci95[0] < KC < kc.ci95[1]
    monkeypatch.setattr(hidden, "_uneven", lambda *_: iter(()))
    assert identify([path], None, SEARCH)["Kc"].half_width < kc.half_width


CURVES: dict[str, tuple[Callable[[Array], Array], int, float, int, set[str]]] = {
    "a sinh is no cubic": (lambda x: np.sinh(3.0 * x) / 3.0, 1500, 5e-5, 0, {"cubic"}),
    # with powers up to the fifth Kc is 0.2 % too low, twice its interval
    "a tanh follows no power": (lambda x: 0.3 * np.tanh(x / 0.3), 4000, 2e-5, 2, {"cubic", "quintic"}),
    # its stiffness has a kink where it is unloaded, which a cubic rounds off: Kc was 2 to 3 % too high
    "a pair of tendons": (lambda x: np.sign(x) * np.expm1(np.abs(x)), 4000, 2e-5, 1, {"hardening", "exponential"}),
}
"""Torques over Kc, the samples, noise and seed of a recording, and terms of which a model of it has one or more."""


@pytest.mark.study
@pytest.mark.parametrize("curve", CURVES)
def test_the_interval_of_kc_holds_that_a_spring_curves_as_no_term_does(make_recording: Maker, curve: str) -> None:
    torque, samples, noise, seed, terms = CURVES[curve]

    def curves(channels: dict[str, Array]) -> None:
        channels["torque"] += 0.02 * (torque(channels["dtheta"]) - channels["dtheta"])

    found = identify([make_recording(samples=samples, noise=noise, seed=seed, change=curves)], None, SEARCH)
    assert terms.intersection(found.model.name.split("+"))
    assert found["Kc"].conditional is not None
    (low, high), (least, most) = found["Kc"].ci95, found["Kc"].conditional.ci95
    assert low < 0.02 < high
    assert high - low > 1.05 * (most - least)


@pytest.mark.study
def test_the_interval_of_kc_holds_that_no_tendon_follows_an_exponential_exactly(make_recording: Maker) -> None:
    """Most of the torque is a tangent: an exponential alone has Kc 1.0 % too low, thirteen times its interval.

    With what departs from it, Kc is in 1.5 half widths.
    """

    def stiffens(channels: dict[str, Array]) -> None:
        angle = channels["dtheta"]
        bend = 0.7 * 1.4 / float(np.abs(angle).max())
        channels["torque"] += 0.02 * 0.62 * (np.tan(bend * angle) / bend - angle)

    found = identify([make_recording(samples=4000, noise=1e-5, seed=1, change=stiffens)], None, SEARCH)
    assert found.model.name == "linear+exponential"
    low, high = found["Kc"].ci95
    assert abs(0.5 * (low + high) - 0.02) < 0.75 * (high - low)


def with_friction(make_recording: Maker, rise: float, seed: int, form: str) -> tuple[float, float]:
    """The error of Bc and half its interval, parts of Bc, of a model with friction that does not fall.

    rise: part of the friction at speed by which it is higher at rest, over half of the highest rate.
    """

    def rubs(channels: dict[str, Array]) -> None:
        sweep(channels, 0.0, seed)
        angle, rate = channels["dtheta"], channels["dtheta_dot"]
        higher = 1.0 + rise * np.exp(-((rate / (0.5 * np.abs(rate).max())) ** 2))
        loaded = np.abs(KC * angle + BC * rate) if form == "capstan" else 8e-3
        friction = 0.1 * loaded * higher * np.sign(rate)
        channels["torque"] = 0.5 * channels["torque"] + 0.5 * (KC * angle + BC * rate) + friction  # half of its noise

    with Recording(make_recording(f"{form}{rise}{seed}.h5", samples=2000, rate=250.0, change=rubs)) as recording:
        signals = prepare(recording, None)
    model = parse(f"linear+offset+{form}").anchored(signals.motion)
    used = model.described(signals.motion)
    found = fit(Problem(model, signals.motion, signals.torque, *model.bounds(signals.motion, 9.0)).of(used))
    step = Step(model.name, "linear", 0.0, 0.0, np.nan, KC, BC, included=True, cost=0.0)
    choice, unchanged = Choice(model, (step,), sticking=True), {"Kc": 0.0, "Bc": 0.0}
    bc = average.averaged(choice, signals, used, found.nonlinear, unchanged)["Bc"]
    return bc.value / BC - 1.0, bc.half_width / BC


@pytest.mark.study
@pytest.mark.parametrize("form", ["coulomb", "capstan"])
def test_the_interval_of_the_damping_holds_what_friction_that_falls_hides(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    """Models without such friction are sure of a damping that is too low by three times their interval."""
    found = [with_friction(make_recording, rise, 1, form) for rise in (0.0, 0.6)]
    monkeypatch.setattr(average, "hidden", lambda *_: [])
    plain = [with_friction(make_recording, rise, 1, form) for rise in (0.0, 0.6)]
    assert all(abs(error) < half_width for error, half_width in found)
    assert abs(plain[0][0]) < plain[0][1]
    assert abs(plain[1][0]) > 3.0 * plain[1][1]


@pytest.mark.study
def test_allowing_for_friction_that_builds_up_halves_the_error_of_kc_in_half_widths(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Such friction stiffens small motion. A model with friction that reverses at once adds this to Kc."""
    time, friction = np.arange(6000) / 300.0, 5e-4
    moved, model = chirp(time, 0.2, 8.0), parse("linear+coulomb")
    rubbing = building_up(moved, friction / KC, friction)
    noise = 3e-4 * np.random.default_rng(0).standard_normal(len(time))
    read = signals(moved.motion, KC * moved.dtheta + BC * moved.rate + rubbing + noise, 8.0)
    chosen = Step(model.name, "linear", 0.0, 0.0, np.nan, KC, BC, included=True, cost=0.0)

    def beside() -> float:
        choice, used = Choice(model, (chosen,), sticking=True), np.ones(len(time), dtype=bool)
        kc = average.averaged(choice, read, used, np.empty(0), {"Kc": 0.0, "Bc": 0.0})["Kc"]
        return abs(kc.value - KC) / kc.half_width

    monkeypatch.setattr(hidden, "_uneven", lambda *_: iter(()))  # which holds some of it too
    found = beside()
    monkeypatch.setattr(largest, "_building_up", lambda *_: None)
    assert found < 0.5 * beside()


@pytest.mark.study
def test_the_interval_of_the_damping_holds_that_it_grows_with_the_rate_where_noise_hides_that(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the fastest rate damping is twice as high. Models without that are sure of one that is half as high again."""

    def grows(channels: dict[str, Array]) -> None:
        sweep(channels, 0.0, 2)
        rate = channels["dtheta_dot"]
        channels["torque"] += BC * np.abs(rate) * rate / np.abs(rate).max()
        channels["torque"] += 1e-3 * np.random.default_rng(7).standard_normal(len(rate))

    with Recording(make_recording(samples=4000, change=grows)) as recording:
        signals = prepare(recording, None)
    choice, used = choose(None, signals, linear_only=False), np.ones(len(signals), dtype=bool)
    assert choice.model.name == "linear"
    given = (choice, signals, used, np.empty(0), {"Kc": 0.0, "Bc": 0.0})
    found = average.averaged(*given)["Bc"]
    monkeypatch.setattr(average, "hidden", lambda *_: [])
    plain = average.averaged(*given)["Bc"]
    assert abs(found.value - BC) < found.half_width
    assert abs(plain.value - BC) > 3.0 * plain.half_width


def test_effects_that_fit_far_better_than_the_selected_model_are_together_no_likelier(make_recording: Maker) -> None:
    """Damping grows with the rate here, but selection did not take that."""

    def grows(channels: dict[str, Array]) -> None:
        sweep(channels, 0.0, 2)
        rate = channels["dtheta_dot"]
        channels["torque"] += BC * np.abs(rate) * rate / np.abs(rate).max()

    with Recording(make_recording(samples=4000, change=grows)) as recording:
        signals = prepare(recording, None)
    selected = Selected(parse("linear").anchored(signals.motion), np.empty(0), signals)
    larger = largest_model(selected, ())
    assert larger is not None
    likely = list(average._likely_models(larger, np.zeros(len(larger.values)), selected))
    least = min(against for _, against in likely)
    assert likely[0][1] == pytest.approx(least)
    grown = [one.values[1] for one, against in likely[1:] if against == pytest.approx(least)]
    assert len(grown) == 1  # beside a reading of one age; it is less likely beside the other
    assert grown[0] < 0.95 * larger.values[1]


@pytest.mark.parametrize(
    ("friction", "added", "possible"), [(-0.01, (), False), (0.01, (), True), (-0.01, ("coulomb",), True)]
)
def test_a_joint_that_its_friction_would_drive_is_none(friction: float, added: tuple[str, ...], possible: bool) -> None:
    """A little friction of every bench, which the average adds, is a nuisance of either sign."""
    columns = np.random.default_rng(0).standard_normal((500, 3))
    values = np.array([KC, BC, friction])
    sampling, likely = covariance(Blocks.of(columns, columns @ values + 1e-3), values), np.zeros((2, 3))
    found = Largest(parse("linear+coulomb"), added, ["Kc", "Bc", "Fc"], columns, values, values, sampling, likely)
    assert found.is_possible is possible


@pytest.mark.parametrize(("size", "delay"), [(2e-4, 6e-4), (2e-6, 1e-4)])
def test_a_late_reading_has_the_odds_of_the_integral_over_all_skews(
    make_recording: Maker, size: float, delay: float
) -> None:
    """A usual recorder has a tenth of a tick, one bench in ten 4 ms, both one standard deviation."""

    def late(channels: dict[str, Array]) -> None:
        sweep(channels, delay, 0)
        channels["torque"] += (size - 2e-4) * np.random.default_rng(0).standard_normal(len(channels["time"]))

    with Recording(make_recording(change=late)) as recording:
        signals = prepare(recording, None)
    selected = Selected(parse("linear").anchored(signals.motion), np.empty(0), signals)
    larger = largest_model(selected, ())
    assert larger is not None
    at = larger.names.index("skew")
    found, error = larger.values[at], math.sqrt(larger.sampling.matrix[at, at])
    skews, odds = np.linspace(-0.05, 0.05, 200_001), []
    for usual, rare in ((2e-4, 1.0), (4e-3, 0.1)):
        density = np.exp(-0.5 * (skews / usual) ** 2) / usual
        odds.append(rare * float(np.sum(density * np.exp(-0.5 * ((skews - found) / error) ** 2))))
    (_, first), (_, other) = average._late(larger, selected)
    assert other - first == pytest.approx(-2.0 * math.log(odds[1] / odds[0]), abs=1e-3)


def test_an_inertia_that_a_skew_beside_it_makes_negative_is_none() -> None:
    """Kc and Bc are then those without it: no joint has a negative inertia."""
    time = np.linspace(0.0, 20.0, 4000)
    waves = [np.exp(1j * (w * time + w)) for w in (3.0, 7.1, 19.0, 43.0)]
    angle, rate, acceleration = (
        sum((1j * w) ** order * wave for w, wave in zip((3.0, 7.1, 19.0, 43.0), waves, strict=True)).real
        for order in range(3)
    )
    noise = 1e-2 * np.random.default_rng(0).standard_normal(4000)
    torque = 0.3 * angle + 3e-3 * rate - 2e-5 * acceleration + noise

    def mean(*columns: Array, terms: str, names: list[str]) -> dict[str, Averaged]:
        stacked = np.column_stack(columns)
        values = least_absolute_deviations(stacked, torque).genes
        sampling = covariance(Blocks.of(stacked, torque), values)
        likely = np.stack([np.zeros(len(names)), np.full(len(names), np.inf)])
        whole = Largest(parse(terms), (), names, stacked, torque, values, sampling, likely)
        return average._mean(whole, {})

    without = mean(angle, rate, terms="linear", names=["Kc", "Bc"])
    beside = mean(angle, rate, acceleration, terms="linear+inertia", names=["Kc", "Bc", "J"])
    for name in ("Kc", "Bc"):
        assert beside[name].value == pytest.approx(without[name].value, abs=0.5 * without[name].half_width)


def test_errors_of_the_deflection_are_computed_within_the_bounds_where_the_largest_fit_ends_beyond_them(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is the fit of a linear problem, in which a branch may come to relax in less than no time."""
    with Recording(make_recording(change=lambda channels: sweep(channels, 0.0, 1))) as recording:
        signals = prepare(recording, None)
    model = parse("linear+maxwell").anchored(signals.motion)
    values, columns = np.array([KC, BC, 0.1 * KC, -0.1]), np.zeros((len(signals.motion), 4))
    sampling = covariance(Blocks.of(np.random.default_rng(0).standard_normal((500, 4)), np.ones(500)), values)
    beyond = Largest(model, (), [p.name for p in model.parameters], columns, values, values, sampling, columns[:2])
    computed: list[Array] = []
    monkeypatch.setattr(average, "read_with_errors", lambda *given: computed.append(given[3]))

    average._by_errors(beyond, signals, np.ones(len(signals.motion), dtype=bool))

    low, high = model.bounds(signals.motion, signals.band[1])
    assert low[0] <= computed[0][3] <= high[0]
    assert computed[0][:3] == pytest.approx(values[:3])


def by_rate_of(torque: Array, left: Array) -> float:
    return by_rate(len(torque), density_at_zero(left, 0.0), float(np.mean(np.abs(torque))))


def test_errors_of_the_rate_decide_between_no_models() -> None:
    """It is known to 0.03 % of the torque: of a fit that is this good the likelihood says nothing."""
    rng = np.random.default_rng(0)
    column, noise = rng.standard_normal((10_000, 1)), rng.standard_normal(10_000)
    assert by_rate_of(column[:, 0], 0.1 * noise) == pytest.approx(0.0, abs=0.1)
    assert by_rate_of(column[:, 0], 1e-4 * noise) > 1000.0


def test_a_value_follows_no_unlikely_model_but_its_interval_reaches_it() -> None:
    """One chance in ten of an estimate that is ten half widths away."""
    near, far = Averaged(1.0, 0.1), Averaged(2.0, 0.1)
    found = average._mixed(np.array([0.9, 0.1]), [near, far])
    assert found.value == pytest.approx(1.0, abs=0.01)
    assert found.value + found.half_width == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e3])
def test_the_interval_of_one_model_is_its_own(scale: float) -> None:
    """To the last digits that are shown, in the smallest joints and the largest."""
    one = Averaged(3.0 * scale, 0.02 * scale)
    found = average._mixed(np.array([1.0]), [one])
    assert found.value == pytest.approx(one.value, rel=1e-9)
    assert found.half_width == pytest.approx(one.half_width, rel=1e-4)  # 1.96 is 1.959964


def test_friction_that_falls_is_computed_where_a_linearised_fit_has_no_way_to_build_up_over(
    make_recording: Maker,
) -> None:
    """The reach of the larger model came out negative, and the friction over it infinite."""
    with Recording(make_recording(change=lambda channels: sweep(channels, 0.0, 1))) as recording:
        signals = prepare(recording, None)
    motion = signals.motion
    model = parse("linear+dahl").anchored(motion)
    problem = Problem(model, motion, signals.torque, *model.bounds(motion, 9.0))
    columns, target = problem.linearised(problem.solve(np.array([0.01])))
    values = np.array([KC, BC, 1e-3, -0.01])
    sampling = covariance(Blocks.of(columns, target), values)
    likely = np.stack([np.zeros(4), np.full(4, np.inf)])
    names = [parameter.name for parameter in model.parameters]
    beyond = Largest(model, (), names, columns, target, values, sampling, likely)
    found = hidden._falling(beyond, Selected(model, np.array([0.01]), signals))
    assert all(np.isfinite(one.column).all() for one in found)


@pytest.mark.parametrize(
    ("name", "nonlinear", "expected"),
    [
        ("linear+offset+maxwell", [0.04], 0.0),
        ("linear+offset+maxwell+skew", [0.04, 1e-3], KC * 1e-3 * (1.0 / 33.0) ** 0.5),
        (
            "linear+offset+maxwell+maxwell2+skew",
            [0.04, 0.4, 1e-3],
            (1.75 * KC * 1e-3 + BC * 1e-3 / 0.004) * (1.0 / 3.0) ** 0.5,
        ),
    ],
)
def test_what_looks_late_may_be_the_damping_of_a_further_branch(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch, name: str, nonlinear: list[float], expected: float
) -> None:
    """Branches of a half and a quarter of Kc, which relax in 40 and 400 ms; a third one would in 4 ms."""
    with Recording(make_recording(change=lambda channels: sweep(channels, 0.0, 1))) as recording:
        signals = prepare(recording, None)
    one = Selected(parse(name).anchored(signals.motion), np.array(nonlinear), signals)
    monkeypatch.setitem(one.__dict__, "values", {"K1": 0.5 * KC, "K2": 0.25 * KC, "Bc": BC})
    assert average._hidden(one, KC) == pytest.approx(expected)


@pytest.mark.parametrize(("gain", "odds"), [(9.0, 0.0), (-2.0, 2.0), (-6.5, None)])
def test_a_term_that_was_refused_on_weak_evidence_is_averaged_over(gain: float, odds: float | None) -> None:
    smaller, chosen = (
        Step(name, name[-6:], 0.0, 0.0, 50.0, KC, BC, included=True, cost=0.0) for name in ("linear", "linear+offset")
    )
    refused = Step("linear+offset+maxwell", "maxwell", 0.0, 0.0, gain, KC - 1e-3, BC, included=False, cost=0.0)
    best = {"Kc": Averaged(KC + 2e-4, 1e-4), "Bc": Averaged(BC, 1e-6)}
    choice = Choice(parse("linear+offset"), (smaller, chosen, refused))
    found = [(rival["Kc"].value, against) for rival, against in average._rivals(choice, ("offset",), best)]
    assert found == ([] if odds is None else [(pytest.approx(KC - 8e-4), odds)])  # type: ignore[comparison-overlap]
