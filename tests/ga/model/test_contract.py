"""What every term of the table keeps, whoever adds it: one contract, held against each record."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel, parse
from ga.model.record import Regressors, Term
from ga.model.terms import TERMS, compatible_model, is_addable
from ga.model.trajectory import Motion

Array = NDArray[np.float64]

HIGHEST, STEP = 11.0, 1e-6
ALL = pytest.mark.parametrize("term", TERMS.values(), ids=lambda term: term.name)
PAGE = (Path(__file__).parents[3] / "docs" / "models.md").read_text(encoding="utf-8")


def moving(size: float = 1.0, speed: float = 1.0) -> Motion:
    """A sum of sines from 0.3 to 11 Hz, in closed form."""
    time = np.linspace(0.0, 4.0, 1601)
    speeds = 2.0 * np.pi * np.geomspace(0.3, HIGHEST, 8)
    waves = size * np.geomspace(0.06, 0.02, 8) * np.exp(1j * (np.outer(time, speeds) + np.arange(8) ** 2))
    dtheta, rate, acceleration = ((waves * (1j * speeds) ** order).sum(axis=1).imag for order in range(3))
    return Motion(time / speed, dtheta, speed * rate, speed**2 * acceleration, np.zeros(len(time)))


MOTION = moving()


def model_with(term: Term, *more: str) -> CouplingModel:
    """The smallest model with the term and, where possible, those others."""
    name = compatible_model(term.name, ("linear", "offset"))
    for other in more:
        name = f"{name}+{other}" if is_addable(other, name.split("+")) else name
    return parse(name).anchored(MOTION)


def within_bounds(model: CouplingModel) -> Array:
    low, high = model.bounds(MOTION, HIGHEST)
    return np.asarray(low + 0.3 * (high - low))


@ALL
def test_the_derivatives_of_a_term_are_those_of_its_torque(term: Term) -> None:
    """With a delay beside it, so that the columns' rates count too; from a state at first that is not the model's."""
    model = model_with(term, "skew")
    nonlinear, genes = within_bounds(model), np.linspace(0.5, 1.5, len(model.linear))
    read = 3.0 + np.cos(5.0 * MOTION.time)
    found = model.jacobian(MOTION, nonlinear, genes, torque=read)
    for k, slope in enumerate(found.T):
        ends = nonlinear + STEP * np.outer([1.0, -1.0], np.arange(len(nonlinear)) == k)
        above, below = (model.columns(MOTION, end) @ genes - model.target(MOTION, read, end) for end in ends)
        expected = (above - below) / (2.0 * STEP)
        alike = np.isclose(slope, expected, rtol=0.01, atol=0.01 * np.abs(expected).max() + 1e-9)
        assert np.mean(alike) > 0.9


@ALL
def test_the_torque_that_a_term_adds_when_the_deflection_changes_is_stated(term: Term) -> None:
    """Or the term stands beside no gap, which takes deflection away."""
    count = sum(not parameter.nonlinear for parameter in term.parameters)
    if term.columns is None:
        assert count == 0
        return
    own = np.array([low + 0.3 * (high - low) for low, high in (term.bounds(MOTION, HIGHEST) if term.bounds else ())])
    genes, moved = np.linspace(0.5, 1.5, count), np.cos(3.0 * MOTION.time)

    def seen(angle: Array) -> Regressors:
        contact = np.ones(len(MOTION))
        return Regressors(
            MOTION.time, MOTION, angle, contact, load=None, damped=True, smoothing=0.1, middle=2.0, own=own
        )

    ends = (term.columns(seen(MOTION.dtheta + side * STEP * moved)) for side in (1.0, -1.0))
    above, below = (np.stack(columns, axis=1) @ genes for columns in ends)
    expected = (above - below) / (2.0 * STEP)
    if term.pushed is None:
        gaps = {name for name, one in TERMS.items() if one.shifts is not None}
        assert not expected.any() or gaps <= set(term.excludes)
    else:
        assert term.pushed(seen(MOTION.dtheta), genes, moved) == pytest.approx(expected, rel=1e-4, abs=1e-5)


@ALL
def test_a_term_whose_parameters_are_absent_adds_nothing(term: Term) -> None:
    model = model_with(term)
    values = dict(zip((one.name for one in model.nonlinear), within_bounds(model).tolist(), strict=True))
    absent = {one.name: one.absent for one in term.parameters if one.absent is not None}
    terms = [name for name in model.name.split("+") if name != term.name]
    if term.name == "linear" or not absent:
        assert not any(one.presence for one in term.parameters)
        return
    smaller, beside = CouplingModel("+".join(terms)).anchored(MOTION), values | absent
    genes = np.array([absent.get(one.name, 1.0) for one in model.linear])
    absent_at = np.array([beside[one.name] for one in model.nonlinear])
    larger = model.columns(MOTION, absent_at) @ genes
    columns = smaller.columns(MOTION, np.array([beside[one.name] for one in smaller.nonlinear]))
    columns = np.stack([model.target(MOTION, column, absent_at) for column in columns.T], axis=1)
    left = larger - columns @ np.linalg.lstsq(columns, larger, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 * np.abs(larger).max()


@ALL
def test_twice_the_torque_is_twice_the_parameters_that_scale_with_it(term: Term) -> None:
    model = model_with(term)
    nonlinear, genes = within_bounds(model), np.linspace(0.5, 1.5, len(model.linear))
    once = model.columns(MOTION, nonlinear, lag=0.01) @ genes
    twice, more = (
        np.array([value * (2.0 if one.scales else 1.0) for value, one in zip(values, parameters, strict=True)])
        for values, parameters in ((genes, model.linear), (nonlinear, model.nonlinear))
    )
    assert model.columns(MOTION, more, lag=0.01) @ twice == pytest.approx(2.0 * once)


def test_a_term_excludes_nothing_that_it_needs_and_needs_no_circle() -> None:
    for term in TERMS.values():
        assert {*term.excludes, *term.or_needs, *term.confusable} <= set(TERMS)
        assert term.name not in term.excludes
        assert all(is_addable(other, (term.name, "linear")) is False for other in term.excludes)
        assert bool(term.excludes) == bool(term.reason), term.name
        chain = [term.name]
        while needed := TERMS[chain[-1]].needs:
            assert needed not in chain
            chain.append(needed)
        assert all(one not in TERMS[other].excludes for one, other in pairwise([*chain, chain[0]]))


@ALL
def test_the_bounds_of_a_term_are_finite_and_hold_what_its_records_say(term: Term) -> None:
    nonlinear = [one for one in term.parameters if one.nonlinear]
    for motion in (MOTION, moving(1e-5), moving(speed=1e-3), replace(MOTION, dtheta=MOTION.dtheta + 2.0)):
        pairs = term.bounds(motion, HIGHEST) if term.bounds else ()
        assert np.isfinite(pairs).all()
        for one, (low, high) in zip(nonlinear, pairs, strict=True):
            assert low < high
            assert low >= 0.0 or not one.positive
            assert one.absent is None or low <= one.absent <= high
            assert all(0.0 <= start <= 1.0 for start in one.starts)


@ALL
def test_a_term_has_an_example_of_its_parameters_of_which_one_is_small_plain_and_large(term: Term) -> None:
    words = [word.partition(" ") for word in term.example.split("; ")]
    assert [name for name, _, _ in words] == [one.name for one in term.parameters]
    assert sorted(values.count(",") for _, _, values in words) == [0] * (len(words) - 1) + [2]


def test_the_page_of_models_names_every_term_and_its_parameters() -> None:
    rows = [line.split("|") for line in PAGE.splitlines() if line.startswith("|")]
    for term in TERMS.values():
        row = next(row for row in rows if f"`{term.name}`" in row[1])
        named = {name.strip() for name in row[3].replace(";", ",").split(",")}
        assert {one.name for one in term.parameters} <= named, term.name
