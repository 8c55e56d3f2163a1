"""Diagnostics of parameters that are not identifiable."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.servo import Status
from ga.model.coupling import parse
from ga.model.memory import yielding
from ga.model.trajectory import Motion
from hil.diagnostics import Diagnostic
from hil.identification.identify import identify
from hil.identification.misfit.effects import effect_of
from hil.identification.misfit.outcome import LackOfFit, Respect, Suspect
from hil.identification.result import Estimate, Identification, Repeatability
from hil.identification.verdict import confounding
from hil.identification.verdict.evidence import Evidence, span_met, span_of_stiffness, with_misfit
from hil.identification.verdict.identifiability import other_stiffness
from hil.identification.verdict.misfit import lost_by_misfit
from hil.recording.reader import Array
from hil.report.identification import headline, summary_lines
from hil.report.identification_json import as_json
from hil.signals.inspection import inspect

from ..conftest import Maker
from .conftest import SEARCH


def estimate(name: str, value: float, half: float) -> Estimate:
    return Estimate(
        name, "", value, (value - half, value + half), Repeatability(value, value, 0.0), True, None, (0.0, 1.0)
    )


FOUND = (estimate("Kc", 0.02, 1e-5), estimate("Bc", 2e-4, 1e-6))


def sine(channels: dict[str, Array], frequency: float) -> None:
    """0.2 rad at one frequency, with 1 mN m of dry friction beside the paper's coupling."""
    phase = 2.0 * np.pi * frequency * channels["time"]
    rate = 0.4 * np.pi * frequency * np.cos(phase)
    channels["dtheta"], channels["dtheta_dot"] = 0.2 * np.sin(phase), rate
    channels["torque"] = 0.02 * channels["dtheta"] + 2e-4 * rate + 1e-3 * np.sign(rate)
    channels["torque"] += 1e-4 * np.random.default_rng(1).standard_normal(len(phase))


def driven_backwards(channels: dict[str, Array]) -> None:
    """Two speeds, and a torque of 1 mN m along the motion: the friction of a model would have to be negative."""
    time = channels["time"]
    channels["dtheta"] = 0.2 * np.sin(6.0 * time) + 0.05 * np.sin(40.0 * time)
    rate = channels["dtheta_dot"] = 1.2 * np.cos(6.0 * time) + 2.0 * np.cos(40.0 * time)
    channels["torque"] = 0.02 * channels["dtheta"] + 2e-3 * rate - 1e-3 * np.sign(rate)
    channels["torque"] += 1e-4 * np.random.default_rng(1).standard_normal(len(time))


def test_a_friction_that_would_be_negative_is_zero_and_makes_the_damping_untrustworthy(make_recording: Maker) -> None:
    path = make_recording(samples=1000, change=driven_backwards)
    found = identify([path], parse("linear+coulomb"), SEARCH)
    assert found["Fc"].value == found["Fc"].exact == found["Fc"].ci95[0] == 0.0
    assert (found.trusted("Kc"), found.trusted("Bc")) == (True, False)
    (said,) = [one for one in found.diagnostics if one.code == "implausible"]
    found_size = re.search(r"Fc would be (\S+) N m, but it cannot be negative", said.message)
    assert found_size is not None
    assert float(found_size[1]) == pytest.approx(-0.001, rel=0.02)


def against_damping(channels: dict[str, Array]) -> None:
    """As without dry friction, but the torque helps the motion as a negative damping would."""
    driven_backwards(channels)
    channels["torque"] = 0.02 * channels["dtheta"] - 2e-3 * channels["dtheta_dot"]
    channels["torque"] += 1e-4 * np.random.default_rng(1).standard_normal(len(channels["time"]))


@pytest.mark.study
@pytest.mark.parametrize("named", [True, False])
def test_model_selection_is_a_remedy_only_where_the_model_was_named(make_recording: Maker, named: bool) -> None:
    found = identify([make_recording(samples=1000, change=against_damping)], parse("linear") if named else None, SEARCH)
    (said,) = [one for one in found.diagnostics if one.code == "implausible" and one.parameter == "Bc"]
    assert "Bc would be -0.002 N m s/rad" in said.message
    assert ("--model auto" in said.message) is named


def numbers_in(table: Any) -> Iterator[float]:
    """The values, ends of intervals and bounds of Kc and Bc in a result's JSON."""
    for one in (table["parameters"][name] for name in ("Kc", "Bc")):
        yield from (one["value"], one["conditional"]["value"], one["optimiser_repeatability"]["best"])
        yield from (end for ends in (one["ci95"], one["conditional"]["ci95"], one["bounds"]) for end in ends)


def inverted(channels: dict[str, Array]) -> None:
    channels["torque"] *= -1.0


def test_a_wrong_sign_is_the_answer_and_no_value_stands_beside_it(make_recording: Maker) -> None:
    path = make_recording(samples=600, noise=1e-4, change=inverted)
    found = identify([path], None, SEARCH)
    assert found.model.name == "linear+offset"  # no matter of model selection
    assert all(number >= 0.0 for number in numbers_in(as_json(found)) if number is not None)
    wrong = "(not identifiable: a sign is wrong)"
    assert headline(found) == f"Kc {wrong},  Bc {wrong}"
    assert [one.code for one in found.diagnostics if one.is_error] == ["implausible"]
    for said in ("Kc would be -0.0201 N m/rad", "A sign is wrong", "--torque-scale -1"):
        assert said in found.diagnostics[0].message
    (work,) = summary_lines(found)
    assert work.startswith("excited band")


def of_another_joint(channels: dict[str, Array]) -> None:
    channels["torque"] = 0.01 * np.random.default_rng(1).standard_normal(len(channels["time"]))


def test_a_torque_that_the_deflection_does_not_cause_is_no_wrong_sign(make_recording: Maker) -> None:
    found = identify([make_recording(samples=600, change=of_another_joint)], parse("linear"), SEARCH)
    assert any("Torque and deflection hardly depend on each other" in one.message for one in found.diagnostics)
    assert not found.trusted("Kc")
    assert not found.trusted("Bc")
    assert "sign" not in headline(found)


@pytest.mark.study
def test_model_selection_never_includes_a_negative_friction(make_recording: Maker) -> None:
    found = identify([make_recording(samples=1000, change=driven_backwards)], None, SEARCH)
    assert "coulomb" not in found.model.name


def triangle(channels: dict[str, Array]) -> None:
    """One speed there and back, 0.8 rad/s, with as much dry friction."""
    sine(channels, 1.0)
    rate = 0.8 * np.sign(channels["dtheta_dot"])
    channels["dtheta"] = 0.4 / np.pi * np.arcsin(channels["dtheta"] / 0.2)
    channels["torque"] += 0.02 * (channels["dtheta"] - 0.2 * np.sin(2.0 * np.pi * channels["time"]))
    channels["torque"] += 2e-4 * (rate - channels["dtheta_dot"])
    channels["dtheta_dot"] = rate


def of_damping(found: Identification) -> list[Diagnostic]:
    return [diagnostic for diagnostic in found.diagnostics if diagnostic.parameter == "Bc"]


def test_a_damping_seen_at_one_speed_is_not_told_from_dry_friction(make_recording: Maker) -> None:
    found = identify([make_recording(change=triangle)], parse("linear"), SEARCH)
    assert found["Bc"].value > 4.0 * 2e-4  # friction is in it, and its interval knows nothing of that
    assert found["Kc"].identifiable
    assert not found["Bc"].identifiable
    (said,) = of_damping(found)
    assert (said.code, said.is_error) == ("not-identifiable", True)
    assert "from dry friction" in said.message
    assert "several speeds" in said.message


@pytest.mark.study
def test_a_sine_is_said_to_have_little_but_one_speed(make_recording: Maker) -> None:
    path = make_recording(samples=1000, change=lambda channels: sine(channels, 5.0))
    seen = of_damping(identify([path], parse("linear"), SEARCH))
    assert [(one.code, one.is_error) for one in seen] == [("hidden-friction", False), ("misfit", True)]
    assert not of_damping(identify([path], parse("linear+coulomb"), SEARCH))


def relaxing(channels: dict[str, Array]) -> None:
    """A sine of 3 Hz on a coupling of which a part of 30 % relaxes in 0.1 s, in the form that this torque has then."""
    phase = 6.0 * np.pi * channels["time"]
    rate, part = 1.2 * np.pi * np.cos(phase), (0.6 * np.pi) ** 2
    channels["dtheta"], channels["dtheta_dot"] = 0.2 * np.sin(phase), rate
    stiffness, damping = 0.02 + 0.006 * part / (1.0 + part), 2e-4 + 6e-4 / (1.0 + part)
    channels["torque"] = stiffness * channels["dtheta"] + damping * rate
    channels["torque"] += 1e-4 * np.random.default_rng(1).standard_normal(len(phase))


@pytest.mark.study
@pytest.mark.parametrize(("model", "trusted"), [(None, False), ("linear", True)])
def test_one_frequency_identifies_no_coupling_unless_its_model_is_known(
    make_recording: Maker, model: str | None, *, trusted: bool
) -> None:
    found = identify([make_recording(samples=1000, change=relaxing)], parse(model) if model else None, SEARCH)
    said = [one.is_error for one in found.diagnostics if one.code == "one-frequency"]
    assert said == [not trusted]
    assert [found.trusted(name) for name in ("Kc", "Bc")] == [trusted, trusted]


def sequence(channels: dict[str, Array]) -> None:
    """A joint with dry friction that is moved between two places, and rests at each."""
    tick, omega, state, level = 1.0 / 500.0, 60.0, np.zeros(2), np.random.default_rng(5).choice([-0.2, 0.2], 2000)
    for at in range(len(channels["dtheta"])):
        state += tick * np.array([state[1], omega**2 * (level[at // 50] - state[0]) - 2.0 * omega * state[1]])
        channels["dtheta"][at], rate = state
        channels["torque"][at] = 0.3 * state[0] + 3e-3 * rate + 4e-3 * np.sign(rate)
    channels["torque"] += 3e-4 * np.random.default_rng(6).standard_normal(len(channels["torque"]))


def held_between_two_places(model: str, *, every: int, early: float, **friction: tuple[float, float]) -> Evidence:
    """Evidence of a model with friction, by name with half its interval, and a reading early by parts of a tick."""
    channels = {"dtheta": np.zeros(5000), "torque": np.zeros(5000)}
    sequence(channels)
    angle, time = channels["dtheta"], np.arange(5000) / 500.0
    rate = np.gradient(angle, time)
    motion = Motion(time, angle, rate, np.gradient(rate, time), np.zeros(5000), rate_noise=1e-4)
    found = {"Kc": (0.3, 1e-3), "Bc": (3e-3, 1e-4), **friction, "skew": (-early / 500.0, 1e-5)}
    values, half_width = np.array(list(found.values())).T
    evidence = SimpleNamespace(
        names=list(found),
        values=values,
        errors=SimpleNamespace(half_width=half_width),
        selected=True,
        model=parse(model),
        signals=SimpleNamespace(
            motion=motion.of(slice(None, None, every)), coupling_torque=channels["torque"][::every], imported=False
        ),
    )
    return cast("Evidence", evidence)


@pytest.mark.parametrize(
    ("early", "every", "friction", "doubted"),
    [
        # before a slow cell, a friction of 0.03 % stood beside a reading 0.5 ms early, and Kc was 10 % too high
        (0.3, 1, {"Fc": (1e-4, 1e-5)}, True),
        (0.3, 6, {"Fc": (1e-4, 1e-5)}, True),
        (0.3, 1, {"Fc": (4e-3, 1e-5)}, False),
        (0.3, 1, {"Fc": (4e-3, 3.8e-3)}, True),  # its interval says so; Kc was 3.5 % too high
        # at 200 Hz a reading 0.17 ticks early left no friction that could be identified, and Kc was 10 +- 4 % too high
        (0.1, 1, {"Fc": (1e-3, 2e-3)}, True),
        (0.0, 1, {"Fc": (1e-3, 2e-3)}, False),
        (-0.1, 1, {"Fc": (1e-3, 2e-3)}, False),
        # friction in proportion to the torque stood beside a reading 2.7 ticks early, and Kc was 16 +- 16 % too high
        (2.7, 1, {"mu": (0.002, 2e-5), "rest": (0.0, 0.0)}, True),
        (2.7, 1, {"mu": (0.1, 1e-3), "rest": (0.0, 0.0)}, False),
    ],
)
def test_next_to_no_friction_in_the_model_is_not_what_holds_the_joint(
    early: float, every: int, friction: dict[str, tuple[float, float]], *, doubted: bool
) -> None:
    model = f"linear+{'coulomb' if 'Fc' in friction else 'capstan'}+skew"
    evidence = held_between_two_places(model, every=every, early=early, **friction)
    assert bool(confounding._friction_at_rest(evidence)) == doubted


def relaxed_to_two_places(channels: dict[str, Array]) -> None:
    """The same joint behind a drive of first order, whose rate is in proportion to the way that is left."""
    tick, omega, place, level = 1.0 / 500.0, 20.0, 0.0, np.random.default_rng(5).choice([-0.2, 0.2], 2000)
    for at in range(len(channels["dtheta"])):
        rate = omega * (level[at // 150] - place)
        channels["dtheta"][at] = place
        channels["torque"][at] = 0.3 * place + 3e-3 * rate + 4e-3 * np.sign(level[at // 150])
        place += (1.0 - np.exp(-omega * tick)) * (level[at // 150] - place)
    channels["torque"] += 3e-4 * np.random.default_rng(6).standard_normal(len(channels["torque"]))


@pytest.mark.study
@pytest.mark.parametrize(
    ("change", "samples", "model", "code"),
    [
        (sequence, 5000, None, "hidden-friction"),
        (sequence, 5000, "linear+skew", "misfit"),
        (relaxed_to_two_places, 2400, None, "hidden-friction"),
        (relaxed_to_two_places, 2400, "linear+offset", "misfit"),
    ],
)
def test_friction_between_two_places_is_not_trusted_as_stiffness(
    make_recording: Maker, change: Callable[[dict[str, Array]], None], samples: int, model: str | None, code: str
) -> None:
    """Kc is 0.32 +- 0.0001 N m/rad, and the residuals are nothing but noise, but for the jumps of the acceleration.

    Behind a drive of first order, neither a curve nor an early torque reading is in the model selected.
    """
    found = identify([make_recording(samples=samples, change=change)], parse(model) if model else None, SEARCH)
    assert not found.trusted("Kc")
    assert code in {one.code for one in found.diagnostics if one.is_error}


def moved_between_two_places(channels: dict[str, Array]) -> None:
    """A joint behind a drive of second order that does not overshoot; dry friction holds it where it rests."""
    tick, state, level = 1.0 / 5000.0, np.zeros(2), np.random.default_rng(5).choice([-0.2, 0.2], 2000)
    moved = 0.0
    for at in range(len(channels["dtheta"])):
        channels["dtheta"][at], rate = state
        moved = np.sign(rate) if abs(rate) > 2e-3 else moved
        channels["torque"][at] = 0.3 * state[0] + 3e-3 * rate + 0.02 * moved
        for _ in range(10):
            state += tick * np.array([state[1], 900.0 * (level[at // 75] - state[0]) - 60.0 * state[1]])
    channels["torque"] += 1e-3 * np.random.default_rng(6).standard_normal(len(channels["torque"]))


@pytest.mark.parametrize(
    ("model", "trusted"), [pytest.param(None, False, marks=pytest.mark.study), ("linear+inertia", True)]
)
def test_friction_that_is_stiffness_and_inertia_at_every_sample_is_not_trusted_as_these(
    make_recording: Maker, model: str | None, *, trusted: bool
) -> None:
    """Kc is 0.4 N m/rad for 0.3, and the residuals are nothing but noise."""
    found = identify(
        [make_recording(samples=3000, change=moved_between_two_places)], parse(model) if model else None, SEARCH
    )
    assert "inertia" in found.model.name
    assert found.trusted("Kc") == trusted
    assert ("hidden-friction" in {one.code for one in found.diagnostics}) != trusted


LINES = 2.0 * np.pi * np.array([0.4, 1.1, 2.3, 4.1, 6.7, 9.3, 11.6])


def behind(constant: float, inertia: float) -> Callable[[dict[str, Array]], None]:
    """0.3 N m/rad, 3 mN m s/rad and an inertia; the angle is read behind a filter of first order, the torque is not."""

    def change(channels: dict[str, Array]) -> None:
        waves = 0.06 * np.exp(1j * (np.outer(channels["time"], LINES) + np.arange(7.0) ** 2))
        channels["torque"] = (waves * (0.3 + 3e-3j * LINES - inertia * LINES**2)).imag.sum(axis=1)
        channels["torque"] += 6e-4 * np.random.default_rng(6).standard_normal(len(channels["torque"]))
        channels["dtheta"] = (waves / (1.0 + 1j * LINES * constant)).imag.sum(axis=1)

    return change


@pytest.mark.parametrize(
    ("model", "trusted"), [pytest.param(None, False, marks=pytest.mark.study), ("linear+inertia", True)]
)
def test_an_inertia_that_may_be_a_filter_of_the_angle_leaves_bc_open(
    make_recording: Maker, model: str | None, *, trusted: bool
) -> None:
    """Behind a filter of 40 Hz it is Bc + Kc T = 4.19 with an inertia of Bc T; 3 and 1.19 mN m s/rad fit as well."""
    path = make_recording(samples=2500, change=behind(1.0 / (2.0 * np.pi * 40.0), 0.0))
    found = identify([path], parse(model) if model else None, SEARCH)
    assert "inertia" in found.model.name
    (said,) = (one for one in found.diagnostics if one.code == "inertia-in-torque")
    values = [float(number) for number in re.findall(r"([\d.]+) N m s/rad", said.message)]
    assert sorted(values) == pytest.approx([1.19e-3, 3e-3, 4.19e-3], rel=0.03)
    assert [float(cut) for cut in re.findall(r"filter of ([\d.]+) Hz", said.message)] == pytest.approx(
        [15.9, 40.0], rel=0.03
    )
    assert (found.trusted("Bc"), found.trusted("Kc")) == (trusted, True)


@pytest.mark.study
def test_an_angle_that_seems_late_may_have_passed_a_filter(make_recording: Maker) -> None:
    """It is the angle that is behind, by a filter of 100 Hz: Bc stays that of the joint."""
    path = make_recording(samples=2500, change=behind(1.0 / (2.0 * np.pi * 100.0), 0.0))
    found = identify([path], None, SEARCH)
    assert found["skew"].value < 0.0
    assert found["Bc"].value == pytest.approx(3e-3, rel=0.06)
    assert found["Bc"].ci95[0] < 3e-3 < found["Bc"].ci95[1]
    assert found["Kc"].value == pytest.approx(0.3, rel=2e-3)


@pytest.mark.study
def test_an_inertia_that_no_filter_of_the_angle_explains_is_one(make_recording: Maker) -> None:
    found = identify([make_recording(samples=2500, change=behind(0.0, 2e-5))], None, SEARCH)
    assert "inertia-in-torque" in {one.code for one in found.diagnostics}
    assert found.trusted("Bc")
    assert found["Bc"].value == pytest.approx(3e-3, rel=0.02)


def test_a_damping_that_friction_may_be_names_the_friction_and_the_corner(make_recording: Maker) -> None:
    path = make_recording(samples=2000, rate=50.0, change=lambda channels: sine(channels, 0.05))
    (said,) = of_damping(identify([path], parse("linear+coulomb"), SEARCH))
    assert (said.code, said.is_error) == ("not-identifiable", True)
    assert "from friction" in said.message
    assert "Damping shows near" in said.message


@pytest.mark.study
@pytest.mark.parametrize(
    ("model", "noise", "said"),
    [(None, 1.5e-4, "other models that fit equally well"), ("linear", 6e-4, "N m s/rad (95 %)"), ("linear", 1e-4, "")],
)
def test_a_damping_that_is_uncertain_says_by_how_much_and_why(
    make_recording: Maker, model: str | None, noise: float, said: str
) -> None:
    """Motion of up to 4 Hz, where damping shows near 16 Hz; the models differ by when the torque was read."""

    def slow(channels: dict[str, Array]) -> None:
        time, omega = channels["time"], 2.0 * np.pi * np.geomspace(0.2, 4.0, 7)
        phases = np.outer(time, omega) + 0.7 * np.arange(7) ** 2
        channels["dtheta"] = 0.03 * np.sin(phases).sum(axis=1)
        channels["dtheta_dot"] = 0.03 * (omega * np.cos(phases)).sum(axis=1)
        channels["torque"] = 0.02 * channels["dtheta"] + 2e-4 * channels["dtheta_dot"]
        channels["torque"] += noise * np.random.default_rng(1).standard_normal(len(time))

    found = identify([make_recording(samples=8000, change=slow)], parse(model) if model else None, SEARCH)
    assert found.trusted("Bc")
    wide = [one for one in found.diagnostics if one.code == "wide-interval"]
    assert [(one.parameter, one.is_error) for one in wide] == ([("Bc", False)] if said else [])
    for one in wide:
        share = found["Bc"].half_width / found["Bc"].value
        assert share > 0.1
        assert f"Bc is uncertain by {share:.0%}: " in one.message
        assert said in one.message
        assert "Damping shows near" in one.message


def test_recordings_that_differ_by_their_units_are_said_to_differ(make_recording: Maker) -> None:
    paths = [make_recording("a.h5", samples=600, noise=1e-4)]
    paths.append(make_recording("c.h5", samples=600, kc=20.0, bc=0.2, noise=1e-1, seed=2))
    found = identify(paths, parse("linear"), SEARCH)
    for name in ("Kc", "Bc"):
        assert not found[name].identifiable
        assert any(
            "differs between the recordings by" in one.message for one in found.diagnostics if one.parameter == name
        )


@pytest.mark.study
@pytest.mark.parametrize(
    ("stiffnesses", "is_error"), [((0.02, 0.02, 0.022), True), ((0.02, 0.0202, 0.0204, 0.0206), False)]
)
def test_a_recording_that_the_others_do_not_predict_is_an_error_and_no_change_in_time(
    make_recording: Maker, stiffnesses: tuple[float, ...], *, is_error: bool
) -> None:
    paths = [make_recording(f"{at}.h5", kc=kc, noise=1e-4, samples=3000, seed=at) for at, kc in enumerate(stiffnesses)]
    found = identify(paths, parse("linear"), SEARCH)
    (said,) = found.diagnostics
    assert (said.code, said.parameter, said.is_error) == ("recordings-differ", "Kc", is_error)
    assert found.trusted("Kc") is not is_error
    assert found.trusted("Bc")


@pytest.mark.study
def test_no_corner_is_named_where_there_is_none(make_recording: Maker) -> None:
    def nothing(channels: dict[str, Array]) -> None:
        channels["torque"] = 1e-4 * np.random.default_rng(0).standard_normal(len(channels["time"]))

    found = identify([make_recording(samples=1000, change=nothing)], parse("linear"), SEARCH)
    assert any(diagnostic.code == "not-identifiable" for diagnostic in of_damping(found))
    assert not any("inf" in diagnostic.message for diagnostic in found.diagnostics)


def test_a_unit_that_changes_in_the_middle_of_a_recording_is_found(make_recording: Maker) -> None:
    def change(channels: dict[str, Array]) -> None:
        channels["torque"][500:] *= 1e3

    found = identify([make_recording(samples=1000, noise=1e-5, change=change)], parse("linear"), SEARCH)
    assert not found.trustworthy
    assert any(one.code == "misfit" and one.is_error for one in found.diagnostics)
    assert not found.trusted("Kc")


@pytest.mark.study
def test_nothing_is_said_of_a_joint_that_moves_at_several_speeds_in_a_steady_recording(sound: Identification) -> None:
    assert sound.diagnostics == ()
    assert sound.deflection is None
    assert sound["Bc"].value == sound["Bc"].exact


def test_friction_that_is_not_there_cannot_be_distinguished_from_zero(make_recording: Maker) -> None:
    found = identify([make_recording(samples=1000, noise=1e-4)], parse("linear+coulomb"), SEARCH)
    assert not found["Fc"].identifiable
    (said,) = [diagnostic for diagnostic in found.diagnostics if diagnostic.parameter == "Fc"]
    assert (said.code, said.is_error) == ("not-identifiable", False)
    assert "interval includes zero" in said.message
    assert found["Kc"].identifiable


def test_a_recording_that_inspect_calls_unusable_is_an_error_of_identify_too(make_recording: Maker) -> None:
    def late(channels: dict[str, Array]) -> None:
        channels["status"] = np.where(np.arange(2000) % 5 == 0, float(Status.LATE), 0.0)

    path = make_recording(noise=1e-4, change=late)
    found, seen = identify([path], parse("linear"), SEARCH), inspect(path)
    assert not seen.usable
    assert [one for one in found.diagnostics if one.is_error] == [one for one in seen.diagnostics if one.is_error]


def test_a_model_with_two_stiffnesses_says_both() -> None:
    """0.24 N m/rad left, and 1.2 mN m over 20 mrad: 0.3 N m/rad after a reversal."""
    (sliding,) = other_stiffness({"Kc": 0.24, "Bc": 3e-3, "Fd": 1.2e-3, "reach": 0.02})
    (relaxed,) = other_stiffness({"Kc": 0.3, "Bc": 3e-3, "K1": 0.09, "tau1": 0.02})
    chosen = {"model": "linear+drift+boucwen", "spans": "amplitude"}
    (yielding,) = other_stiffness({"Kc": 0.24, "Bc": 3e-3, "Fy": 1.2e-3, "yield": 0.02}, **chosen)
    assert "0.24 N m/rad in large motion, where the friction slides, and 0.3 N m/rad" in sliding.message
    assert "--model linear+drift+boucwen" in yielding.message
    assert yielding.is_error
    assert "0.39 N m/rad in motion much faster than 20 ms (tau1)" in relaxed.message
    assert not any(one.is_error for one in (sliding, relaxed))
    assert other_stiffness({"Kc": 0.3, "Bc": 3e-3}) == []


def test_friction_that_grows_with_the_load_stiffens_small_motion_and_leaves_a_single_kc() -> None:
    """At 0.1 rad a spring of 0.3 N m/rad carries 30 mN m, of which a fifth builds up over 10 mrad: 0.6 N m/rad more."""
    loaded = {"Kc": 0.3, "Bc": 3e-3, "mu": 0.2, "rest": 0.0, "reach": 0.01}
    (sheath,) = other_stiffness(loaded, 0.1)
    assert "0.9 N m/rad in motion of less than 0.01 rad" in sheath.message
    (gear,) = other_stiffness({**loaded, "Fd": 3e-3}, 0.1)
    assert "1.2 N m/rad in motion of less than 0.01 rad" in gear.message
    assert span_of_stiffness(loaded) is span_of_stiffness({**loaded, "Fd": 3e-3}) is None


@pytest.mark.parametrize("reach", [0.001, 0.005, 0.02, 0.1])
def test_stiffness_before_friction_slides_counts_as_far_as_the_motion_meets_it(reach: float) -> None:
    """Held against the slope of friction integrated over a loop of 0.2 rad, up and down."""
    path = np.concatenate([np.linspace(-0.1, 0.1, 4001), np.linspace(0.1, -0.1, 4001)] * 3)
    states = [0.0]
    for step in np.diff(path).tolist():
        states.append(np.sign(step) + (states[-1] - np.sign(step)) * np.exp(-abs(step) / reach))
    up, friction = path[-8002:-4001], np.array(states)[-8002:-4001]
    slope = np.polyfit(up, friction, 1)[0] * 1.2e-3
    time = np.linspace(0.0, 20.0 * np.pi, 1000)
    motion = Motion(time, 0.1 * np.sin(time), 0.1 * np.cos(time), -0.1 * np.sin(time), np.zeros(1000))
    names, values = ["Kc", "Bc", "Fd", "reach"], np.array([0.24, 3e-3, 1.2e-3, reach])
    found = [span_met(motion, names, values, np.full(4, half)) for half in (0.5 * slope, 2.0 * slope)]
    assert found == [(0.24, 0.24 + 1.2e-3 / reach, "amplitude"), None]


@pytest.mark.study
def test_hysteresis_that_nobody_named_leaves_no_single_stiffness(make_recording: Maker) -> None:
    """A joint of which 30 % yields over 20 mrad: the interval holds what is left, 0.21, and the whole, 0.3 N m/rad."""

    def yields(channels: dict[str, Array]) -> None:
        time = channels["time"]
        angle, rate = (0.2 * part for part in (np.sin(9.0 * time) + np.sin(2.3 * time), 9.0 * np.cos(9.0 * time)))
        rate = rate + 0.46 * np.cos(2.3 * time)
        load = yielding(time, rate, 0.02)
        channels["dtheta"], channels["dtheta_dot"] = angle, rate
        noise = np.random.default_rng(1).standard_normal(len(time))
        channels["torque"] = 0.21 * angle + 3e-3 * rate + 0.09 * 0.02 * load + 1e-4 * noise

    path = make_recording(samples=1000, rate=250.0, change=yields)
    found, named = (identify([path], model, SEARCH) for model in (None, parse("linear+offset+boucwen")))
    assert "boucwen" in found.model.name
    assert not found.trusted("Kc")
    low, high = found["Kc"].ci95
    assert low < 0.21
    assert high > 0.3
    assert named.trusted("Kc")
    assert named["Kc"].ci95[1] - named["Kc"].ci95[0] < 0.01


@pytest.mark.study
def test_friction_that_takes_most_of_the_torque_is_a_reason_to_drive_with_more(make_recording: Maker) -> None:
    def rubs(channels: dict[str, Array]) -> None:
        channels["torque"] += 12e-3 * np.sign(np.gradient(channels["dtheta"]))

    found = identify([make_recording(samples=1000, noise=2e-5, change=rubs)], parse("linear+coulomb"), SEARCH)
    (said,) = [one for one in found.diagnostics if one.code == "little-load"]
    assert (said.parameter, said.is_error) == ("Kc", False)
    assert "at least 4 times" in said.message


def test_a_spring_with_one_stiff_side_has_no_single_stiffness() -> None:
    (one,) = other_stiffness({"Kc": 0.08, "Bc": 3e-3, "Ka": -0.08, "turn": 0.05}, spans="direction")
    assert (one.code, one.parameter, one.is_error) == ("two-stiffnesses", "Kc", True)
    assert "0.16 N m/rad on one side of 0.05 rad and 0 N m/rad on the other" in one.message
    assert other_stiffness({"Kc": 0.08, "Bc": 3e-3, "Ka": 0.03, "turn": 0.05}, spans="direction") == []


@pytest.mark.study
def test_a_dead_band_pulled_to_one_end_only_is_no_spring_of_half_the_stiffness(make_recording: Maker) -> None:
    """0.02 N m/rad beyond 0.1 rad, and a joint that moves from 0 to 0.3 rad."""

    def one_sided(channels: dict[str, Array]) -> None:
        time = channels["time"]
        angle, rate = 0.15 - 0.15 * np.cos(5.0 * time), 0.75 * np.sin(5.0 * time)
        angle, rate = angle * (1.0 - 0.2 * np.cos(0.9 * time)), rate * (1.0 - 0.2 * np.cos(0.9 * time))
        rate += (0.15 - 0.15 * np.cos(5.0 * time)) * 0.18 * np.sin(0.9 * time)
        noise = 2e-5 * np.random.default_rng(1).standard_normal(len(time))
        channels["dtheta"], channels["dtheta_dot"] = angle, rate
        channels["torque"] = 0.02 * np.maximum(angle - 0.1, 0.0) + 2e-4 * rate + noise

    found = identify([make_recording(samples=1500, rate=250.0, change=one_sided)], None, SEARCH)
    low, high = found["Kc"].ci95
    assert low <= 0.02 <= high
    assert high - low < 0.002 or not found.trusted("Kc")


def lack_of_fit(kc: float, *, outside: tuple[str, ...] = ()) -> LackOfFit:
    """A model that leaves out what moves Kc by a part of its value, which the motion shows beyond any doubt."""
    failed = (Respect("memory", "the torque depends on the earlier motion", 1e-6),)
    suspects = (Suspect(effect_of("drift"), 0.5, kc, 0.0),)
    nothing = np.zeros((0, 2))
    return LackOfFit(failed, 0.5, suspects, kc, 0.0, outside, 5000, nothing[:, 0], nothing, nothing, unexplained=0.1)


@pytest.mark.parametrize(("lack", "known"), [(0.25, True), (0.35, False)])
def test_what_a_model_leaves_out_may_make_the_interval_of_kc_too_wide(lack: float, known: bool) -> None:
    """With 5 % given the model, 30 and 40 % are below and above the 35 % that an interval may have."""
    before = (estimate("Kc", 0.02, 0.001), FOUND[1])
    found = with_misfit(before, lack_of_fit(lack))

    assert found[0].half_width == pytest.approx((0.05 + lack) * 0.02)
    assert [one.identifiable for one in found] == [known, True]
    said = lost_by_misfit(before, found)
    assert [(one.parameter, one.is_error) for one in said] == ([] if known else [("Kc", True)])
    assert known or "it is uncertain by 40 %, of which effects" in said[0].message


def test_a_misfit_that_is_an_error_by_itself_needs_no_other() -> None:
    before = (estimate("Kc", 0.02, 0.001), FOUND[1])
    found = with_misfit(before, lack_of_fit(0.35, outside=("Kc",)))

    assert found[0].half_width == pytest.approx(0.4 * 0.02)
    assert lost_by_misfit(before, found) == []


@pytest.mark.parametrize(("alike_to", "half", "known"), [(3, 0.1, True), (3, 0.4, False), (0, 0.1, False)])
def test_a_parameter_that_only_its_own_term_is_like_is_known_within_its_interval(
    alike_to: int, half: float, known: bool
) -> None:
    """Kh beside the exponent (3), of its term, or beside Kc (0): of their columns all but 1e-4 is the same."""
    model = parse("linear+exponential")
    columns = np.random.default_rng(1).standard_normal((500, 4))
    columns[:, 2] = columns[:, alike_to] + 1e-2 * columns[:, 2]
    parameters = (*model.linear, *model.nonlinear)
    evidence = SimpleNamespace(
        model=model,
        parameters=parameters,
        names=[parameter.name for parameter in parameters],
        solution=SimpleNamespace(columns=columns),
        values=np.ones(4),
        errors=SimpleNamespace(half_width=np.full(4, half)),
    )
    assert evidence.names == ["Kc", "Bc", "Kh", "exponent"]
    assert Evidence._known_beside_its_term(cast("Evidence", evidence), 2) is known
    assert not Evidence._known_beside_its_term(cast("Evidence", evidence), 0)


@pytest.mark.parametrize(
    ("model", "advised"),
    [("linear+offset", "linear+offset+maxwell"), ("linear+offset+maxwell", "linear+offset+maxwell+maxwell2")],
)
def test_a_joint_that_still_relaxes_is_advised_a_branch_that_its_model_lacks(model: str, advised: str) -> None:
    assert effect_of("viscoelastic").remedy(model.split("+")).startswith(f"try --model {advised}, read K'(f)")


def test_a_joint_that_relaxes_beside_all_branches_is_not_advised_the_model_that_it_has() -> None:
    advice = effect_of("viscoelastic").remedy(["linear", "offset", "maxwell", "maxwell2"])
    assert advice.startswith("read K'(f) and B'(f)")
