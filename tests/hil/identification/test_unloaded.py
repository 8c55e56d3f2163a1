"""Where a joint is unloaded, which decides what the Kc of a spring that curves is."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.coupling import parse
from ga.model.terms import TERMS
from ga.model.trajectory import Motion
from hil.identification.fitting.unloaded import UNLOADED_PLACE, Unloaded, unloaded
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.writer import Header, write
from hil.signals.defects import Defects
from hil.signals.prepare import Signals

from .conftest import SEARCH

Array = NDArray[np.float64]

KC, BC, K3, KP = 0.3, 3e-3, 2.0, 0.5
"""SI; over the motion the cubic spring stiffens by 75 %, the progressive one by 25 % to one side."""
TIME = np.arange(2500) / 500.0


def moved(middle: float = 0.1) -> tuple[Array, Array]:
    """A deflection, rad, about a place beside the unloaded one, and its rate, rad/s."""
    speeds = 2.0 * np.pi * np.geomspace(0.4, 10.0, 15)
    waves = 0.03 * np.exp(1j * (np.outer(TIME, speeds) + np.arange(15) ** 2))
    return middle + waves.real.sum(axis=1), -(waves.imag @ speeds)


def cubic(deflection: Array, rate: Array, seed: int = 0) -> Array:
    """A torque, N m, alike on both sides of the unloaded place."""
    noise = 5e-4 * np.random.default_rng(seed).standard_normal(len(rate))
    return KC * deflection + K3 * deflection**3 + BC * rate + noise


def progressive(deflection: Array, rate: Array) -> Array:
    """A torque, N m, that stiffens in one direction."""
    return cubic(deflection, rate) - K3 * deflection**3 + KP * deflection**2


def seen(angle: Array, torque: Array, rate: Array) -> Signals:
    zero = np.zeros_like(angle)
    return Signals(Motion(TIME, angle, rate, zero, zero), torque, Defects(), (0.4, 10.0), 0.0, "given")


def recorded(path: Path, angle: Array, torque: Array, *, model: str | None = None) -> Identification:
    write(
        path, Header(profile={"kind": "prescribed"}, stand_toml=""), {"time": TIME, "torque": torque, "dtheta": angle}
    )
    return identify([path], parse(model) if model else None, SEARCH)


def held(found: Identification) -> bool:
    low, high = found["Kc"].ci95
    return low <= KC <= high


@pytest.mark.parametrize("shift", [0.07, -0.3, 2.0])
def test_the_zeros_of_torque_and_spring_are_believed_against_another_zero_of_the_encoder(shift: float) -> None:
    deflection, rate = moved()
    place = unloaded(seen(deflection + shift, cubic(deflection, rate), rate))

    assert place.agreed
    assert place.reference == pytest.approx(shift, abs=1e-3)


def test_the_encoders_zero_is_believed_beside_an_offset_of_the_torque_or_a_spring_that_is_not_symmetric() -> None:
    deflection, rate = moved()

    assert unloaded(seen(deflection, cubic(deflection, rate) + 0.01, rate)) == Unloaded()
    place = unloaded(seen(deflection, progressive(deflection, rate), rate))
    assert (place.reference, place.agreed) == (0.0, True)


def test_a_straight_spring_counts_from_the_encoders_zero_whatever_its_torque_is_there() -> None:
    deflection, rate = moved()

    assert unloaded(seen(deflection + 0.05, KC * deflection + BC * rate, rate)) == Unloaded()


@pytest.mark.study
def test_the_kc_of_a_curving_spring_does_not_depend_on_an_angle_added_to_all_readings(tmp_path: Path) -> None:
    deflection, rate = moved()
    torque = cubic(deflection, rate)
    near, far = (
        recorded(tmp_path / f"{shift}.h5", deflection + shift, torque, model="linear+cubic") for shift in (0.07, 2.5)
    )

    assert held(near)
    assert far["Kc"].value == pytest.approx(near["Kc"].value, rel=1e-6)
    assert far["Kc"].ci95 == pytest.approx(near["Kc"].ci95, rel=1e-6)


def test_where_no_two_places_agree_the_interval_spans_the_stiffness_of_the_motion(tmp_path: Path) -> None:
    deflection, rate = moved()
    torque = cubic(deflection, rate) + 0.005
    found = recorded(tmp_path / "a.h5", deflection + 2.0, torque, model="linear+offset+cubic")

    assert held(found)
    assert found["Kc"].depends_on == UNLOADED_PLACE
    assert "unloaded-place" in [one.code for one in found.diagnostics if one.parameter == "Kc"]


def test_where_the_place_is_unknown_the_interval_spans_a_stiffness_that_rises_in_both_directions() -> None:
    values = {"Kc": KC, "Kh": 0.5}
    span = Unloaded(low=-0.1, high=0.2, agreed=False).span(values, [TERMS["hardening"]])
    assert span is not None
    assert span[:2] == pytest.approx((KC, KC + 2.0 * 0.5 * 0.2))


@pytest.mark.parametrize(("term", "rise"), [("exponential", "Kh"), ("toe", "Kp")])
def test_the_interval_spans_a_stiffness_that_rises_exponentially(term: str, rise: str) -> None:
    """d/dx of 2 (e^(bx) - 1 - bx)/b^2 is 2 (e^(bx) - 1)/b."""
    values = {"Kc": KC, rise: 0.01, "exponent": 5.0}
    span = Unloaded(low=0.0, high=0.2, agreed=False).span(values, [TERMS[term]])
    assert span is not None
    assert span[:2] == pytest.approx((KC, KC + 2.0 * 0.01 * math.expm1(1.0) / 5.0))


@pytest.mark.study
def test_one_zero_alone_is_not_believed_unless_a_model_without_an_offset_is_named(tmp_path: Path) -> None:
    deflection, rate = moved()
    asked = {"angle": deflection + 2.0, "torque": progressive(deflection, rate)}
    offset, none = (
        recorded(tmp_path / f"{number}.h5", **asked, model=model)
        for number, model in enumerate(("linear+offset+progressive", "linear+progressive"))
    )

    assert held(offset)
    assert held(none)
    assert none["Kc"].depends_on is None
    widths = [one["Kc"].ci95[1] - one["Kc"].ci95[0] for one in (offset, none)]
    assert widths[0] > 10.0 * widths[1]


@pytest.mark.study
def test_the_place_where_a_stiffness_changes_counts_from_the_encoders_zero(tmp_path: Path) -> None:
    deflection, rate = moved(0.0)
    torque = cubic(deflection, rate) - K3 * deflection**3 + 0.1 * np.abs(deflection)

    found = recorded(tmp_path / "a.h5", deflection + 2.0, torque, model="linear+offset+asymmetric")

    assert found["turn"].value == pytest.approx(2.0, abs=1e-3)
    assert held(found)


@pytest.mark.study
@pytest.mark.parametrize("knee", [0.0, 0.03])
def test_kc_spans_both_stiffnesses_of_a_spring_that_changes_beside_its_unloaded_place(
    tmp_path: Path, knee: float
) -> None:
    """At that place they are the stiffnesses of two directions, and Kc is their mean."""
    deflection, rate = moved(0.0)
    torque = cubic(deflection, rate) - K3 * deflection**3 + 0.1 * np.maximum(deflection - knee, 0.0)

    found = recorded(tmp_path / "a.h5", deflection, torque)

    low, high = found["Kc"].ci95
    assert (low < KC < high) is (knee > 0.0)
    assert 0.5 * (low + high) == pytest.approx(KC + 0.05, rel=0.01)
    assert ("two-stiffnesses" in [one.code for one in found.diagnostics]) is (knee > 0.0)
    assert found.trustworthy
