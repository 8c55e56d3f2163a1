"""Each effect has its column, also for pieces of a few samples, and is found where a model lacks it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel, parse
from ga.model.record import Role, Term
from ga.model.terms import SMALLEST, TERMS, compatible_model
from ga.model.trajectory import Motion
from hil.identification.candidates.selection import select
from hil.identification.misfit.effects import EFFECTS, Effect, reading_noise
from hil.identification.misfit.lack_of_fit import Residuals, lack_of_fit
from hil.signals.defects import Defects
from hil.signals.prepare import Signals

Array = NDArray[np.float64]

KC, BC, HIGHEST = 0.3, 3e-3, 12.0
MARKED = [
    pytest.param(term, id=term.name, marks=() if at % 3 == 0 else pytest.mark.study)
    for at, term in enumerate(term for term in TERMS.values() if term.mark is not None)
]


def moving() -> Motion:
    """A sum of 25 sines from 0.3 to 12 Hz, over 16 s."""
    time, speeds = np.arange(4000) / 250.0, 2.0 * np.pi * np.geomspace(0.3, HIGHEST, 25)
    waves = 0.02 * np.exp(1j * (np.outer(time, speeds) + np.arange(25) ** 2))
    angle, rate, acceleration = ((waves * (1j * speeds) ** order).real.sum(axis=1) for order in range(3))
    return Motion(time, angle, rate, acceleration, np.zeros(len(time)))


MOTION = moving()


def example(term: Term) -> tuple[CouplingModel, Array, Array]:
    """The smallest model with a term, its nonlinear parameters, and a torque (n,) of which the term is a tenth.

    Two relaxation times differ.
    """
    model = parse(compatible_model(term.name, ("linear", "offset"))).anchored(MOTION)
    low, high = model.bounds(MOTION, HIGHEST)
    kinds = [one.kind for one in model.nonlinear]
    starts = [
        one.starts[(len(one.starts) - 1) // 2 - kinds[:at].count(one.kind) :] for at, one in enumerate(model.nonlinear)
    ]
    values = [
        [least + start * (most - least) for start in own] for own, least, most in zip(starts, low, high, strict=True)
    ]
    nonlinear = np.array([own[int(own[0] == one.absent)] for own, one in zip(values, model.nonlinear, strict=True)])
    columns = model.columns(MOTION, nonlinear, BC / KC)
    size = 0.1 * KC * np.std(MOTION.dtheta) / np.sqrt(np.mean(columns**2, axis=0))
    genes = np.array([{"Kc": KC, "Bc": BC}.get(one.name, own) for one, own in zip(model.linear, size, strict=True)])
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(MOTION))
    return model, nonlinear, columns @ genes + noise


@pytest.mark.parametrize("term", MARKED)
def test_the_mark_of_a_term_is_the_first_in_what_a_model_without_it_leaves(term: Term) -> None:
    """What makes a torque late is like an inertia or a branch to first order, and counts as one."""
    model, nonlinear, torque = example(term)
    values = dict(zip((one.name for one in model.nonlinear), nonlinear.tolist(), strict=True))
    others = [name for name in model.name.split("+") if name != term.name]
    smaller = CouplingModel("+".join(others)).anchored(MOTION)
    columns = smaller.columns(MOTION, np.array([values[one.name] for one in smaller.nonlinear]))
    fitted = np.linalg.lstsq(columns, torque, rcond=None)[0]
    residuals, half = torque - columns @ fitted, (1e-3, 1e-5)
    found = lack_of_fit(Residuals(MOTION, torque, residuals, columns, (0, 1), (fitted[0], fitted[1]), half))
    assert found is not None
    assert found.misfit
    assert term.mark is not None
    late: tuple[Role, ...] = ("channel", "mass", "branch")
    first = found.suspects[0].effect
    assert first.code == term.mark.code or (term.role in late and any(first.is_of(role) for role in late))


SEVERAL = tuple(name for name, one in TERMS.items() if one.selection != "named" and name not in SMALLEST.split("+"))


@pytest.mark.study
@pytest.mark.parametrize("term", SEVERAL)
def test_the_selection_finds_a_term_or_a_law_that_is_as_good(term: str) -> None:
    model, _, torque = example(TERMS[term])
    signals = Signals(MOTION, torque, Defects(), (0.3, HIGHEST), 0.0, "given")
    found = select(signals, np.ones(len(MOTION), dtype=bool), SEVERAL)
    others = {"quintic": "exponential"}
    assert {term, others.get(term)}.intersection(found.chosen.terms), (model.name, found.model.name)
    assert found.chosen.stiffness == pytest.approx(KC, rel=0.03)
    assert found.chosen.damping == pytest.approx(BC, rel=0.05)


def _in_pieces(*lengths: int) -> Motion:
    time = np.arange(sum(lengths)) / 500.0
    deflection = 0.2 * np.sin(2.0 * np.pi * 1.3 * time) + 1e-4 * np.random.default_rng(5).standard_normal(len(time))
    starts = (0, *np.cumsum(lengths)[:-1].tolist())
    rate = np.gradient(deflection, time)
    return Motion(time, deflection, rate, np.gradient(rate, time), np.zeros(len(time)), starts=starts)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.code)
def test_an_effect_has_a_finite_column_where_pieces_are_short(effect: Effect) -> None:
    motion = _in_pieces(400, 1, 2, 3, 6, 7, 381)
    for columns in effect.signature(motion, 0.3 * motion.dtheta, 0.3 * motion.dtheta):
        assert columns.shape[0] == 800
        assert np.isfinite(columns).all()


def test_the_noise_of_readings_is_taken_within_a_piece_and_not_at_its_ends() -> None:
    motion = _in_pieces(100, 4, 9)
    noise, value = reading_noise(motion), motion.dtheta
    # the sixth difference of binomial weights, scaled to 1 at the middle
    expected = sum(w * value[50 + k] for k, w in enumerate((-1, 6, -15, 20, -15, 6, -1), start=-3)) / 20.0
    assert noise[50] == pytest.approx(expected, abs=1e-15)
    assert np.flatnonzero(noise).tolist() == [*range(3, 97), *range(107, 110)]
