"""What `hil design` predicts to be identifiable, `hil identify` identifies, and the other way round."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from drivers.servo import Quantity
from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse as model_of
from hil.acquisition import excitation
from hil.acquisition.run import run
from hil.experiment_design.advice import of_profile
from hil.experiment_design.assessment import assess, task_of
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.verdict.criteria import friction_likeness
from hil.stand.file import SIMULATED, parse

RATE, DURATION = 250.0, 6.0
SEARCH = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})


class Case(NamedTuple):
    """An excitation and a model, and which of Kc and Bc they leave unknown."""

    kind: str
    band: tuple[float, float]
    mode: str
    amplitude: float
    model: str
    unknown: set[str]


CASES = [
    Case("ramp", (0.5, 0.5), "position", 0.2, "linear", {"Bc"}),
    Case("multisine", (1.0, 15.0), "torque", 0.006, "linear+offset+coulomb", set()),
    Case("chirp", (0.5, 15.0), "torque", 0.006, "linear", set()),
    Case("prbs", (0.5, 15.0), "torque", 0.006, "linear", set()),
    Case("sine", (2.0, 2.0), "torque", 0.006, "linear", set()),
    Case("sine", (0.1, 0.1), "torque", 0.003, "linear", {"Bc"}),
]


@pytest.mark.study
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.kind} {case.band[1]:g} Hz")
def test_design_and_identify_agree_on_what_is_identifiable(tmp_path: Path, case: Case) -> None:
    stand = parse(SIMULATED)
    task = task_of(stand, kc=None, bc=None, torque_noise=None, model=case.model, mode=Quantity(case.mode), rate=RATE)
    profile = excitation.make(
        case.kind,
        task.mode,
        amplitude=case.amplitude,
        default_amplitude=case.amplitude,
        duration=DURATION,
        band=case.band,
        rate=RATE,
        fade=0.1,
        seed=1,
    )
    warned = {one.parameter for one in of_profile(task, assess(task, profile)) if one.code == "not-identifiable"}
    path, outcome = run(stand, profile, rate=RATE, seed=1, output=tmp_path / "a.h5", force=True)
    assert outcome.error is None
    found = identify([path], model_of(case.model), SEARCH)
    refused = {name for name in ("Kc", "Bc") if not found[name].identifiable}
    assert warned & {"Kc", "Bc"} == refused == case.unknown


def test_a_triangle_is_like_friction_and_motion_at_many_speeds_is_less_so() -> None:
    """The closed forms: a rate of one size has 1, a sine 8/pi^2, a Gaussian rate 2/pi."""
    phase = np.linspace(0.0, 2.0 * np.pi, 100_001)[:-1]
    assert friction_likeness(np.sign(np.sin(phase) + 1e-9)) == pytest.approx(1.0)
    assert friction_likeness(np.sin(phase)) == pytest.approx(8.0 / np.pi**2, rel=1e-6)
    assert friction_likeness(np.random.default_rng(0).standard_normal(100_000)) == pytest.approx(2.0 / np.pi, rel=0.02)
    assert friction_likeness(np.zeros(10)) == 0.0
