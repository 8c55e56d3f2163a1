"""Samples in which friction sticks are distinguished from those in which it slides, and left out of a model with it.

The recordings are of the simulated stand, whose LuGre friction knows nothing of the models: the joint rests at every
reversal until the drive has pulled it through twice the friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from drivers.servo import Quantity
from ga.model.coupling import parse as model_of
from ga.model.separable import Problem, fit
from ga.model.trajectory import Motion
from hil.acquisition.excitation import make
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.recorder import Recorder, tick_count
from hil.errors import Untrustworthy
from hil.identification.candidates import choice as choosing
from hil.identification.candidates.choice import _is_sticking, choose
from hil.identification.candidates.fits import Candidate, Fits
from hil.identification.candidates.selection import Selection
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter
from hil.signals.defects import Defects
from hil.signals.prepare import Signals, prepare
from hil.stand.file import parse
from hil.stand.opening import open_servo

KC, RATE = 17.75e-3, 500.0
STAND = """
[stand]
name = "with friction"
backend = "sim"
gear_ratio = 4.0
motor_inertia = 2e-7
motor_damping = 1e-7
torque_source = "joint"
[limits]
torque = 0.08
deflection = 1.0
velocity = 100.0
temperature = 80.0
[sim.coupling]
coulomb_friction = {friction}
static_friction_ratio = 1.0
bristle_stiffness = {stiffness}
bristle_damping = 0.0
[sim.fixture]
stiffness = 2000.0
damping = 0.1
[sim.drive]
torque_limit = 0.02
command_delay = 2e-4
position_gain = 0.015
position_integral_gain = 0.0
position_damping_gain = 7e-5
[sim.sensors]
motor_counts = 16777216
joint_encoder = false
reports_velocity = false
torque_cell_bandwidth = 20000.0
torque_cell_offset = 0.0
torque_cell_drift = 0.0
torque_cell_lsb = 1e-7
joint_torque_delay = {skew}
[sim.link]
jitter = 0.0
"""


@cache
def recorded(friction: float, skew: float = 0.0) -> Signals:
    """Ten seconds of a chirp from 0.2 to 12 Hz; the friction builds up over 50 urad, whatever its size."""
    text = STAND.format(friction=friction, stiffness=2e4 * friction, skew=skew)
    stand = parse(text)
    profile = make(
        "chirp", Quantity.POSITION, amplitude=0.376, default_amplitude=0.376, duration=10.0, band=(0.2, 12.0), rate=RATE
    )
    servo, truth = open_servo(stand, seed=0, realtime=False)
    header = Header(profile=profile.attributes() | {"rate": RATE}, stand_toml=text, truth=truth, seed=0)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        try:
            with RecordingWriter(path, header, tick_count(profile, RATE)) as part:
                part.finish(Recorder(stand, servo, profile, RATE, part).run(StopRequest()).end_reason)
        finally:
            servo.close()
        with Recording(path) as recording:
            return prepare(recording, stand.stand)


def error(found: Signals, model: str, *, of_all: bool) -> float:
    """The error of Kc from the samples that the choice includes, or from all of them."""
    choice = choose(model_of(model), found, linear_only=False)
    problem = Problem(choice.model, found.motion, found.torque, *choice.model.bounds(found.motion, found.band[1]))
    taken = problem if of_all else problem.of(choice.described(found))
    return abs(float(fit(taken).optimum.genes[0]) / KC - 1.0)


@pytest.mark.study
@pytest.mark.parametrize(
    ("model", "skew"), [("linear+coulomb", 0.0), pytest.param("linear+coulomb+skew", 2e-3, marks=pytest.mark.study)]
)
def test_where_friction_holds_the_joint_its_samples_are_left_out(model: str, skew: float) -> None:
    found = recorded(1e-3, skew)
    choice = choose(model_of(model), found, linear_only=False)
    assert choice.sticking
    assert choice.delay == pytest.approx(skew, abs=1e-4)
    assert 0.85 < choice.described(found).mean() < 0.95
    assert error(found, model, of_all=False) < 1.5e-3
    assert error(found, model, of_all=True) > 2e-3
    assert choose(model_of("linear+offset"), found, linear_only=False).described(found).all()  # a model without it


@pytest.mark.study
def test_where_there_is_next_to_no_friction_all_samples_are_taken() -> None:
    found = recorded(1e-6)
    choice = choose(model_of("linear+coulomb"), found, linear_only=False)
    assert not choice.sticking
    assert choice.described(found).all()


@pytest.mark.study
def test_model_selection_leaves_them_out_as_well() -> None:
    choice = choose(None, recorded(1e-3), linear_only=False)
    assert {*choice.model.name.split("+")} - {"offset"} == {"linear", "coulomb"}
    assert choice.sticking
    assert all(abs(step.Kc / KC - 1.0) < 3e-3 for step in choice.steps if step.included and step.term == "coulomb")


@pytest.mark.study
def test_where_no_smooth_friction_can_be_fitted_the_samples_are_left_out_as_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What cannot be fitted is no model; it does not keep the others from being one."""
    candidate = Fits.candidate

    def fitted(fits: Fits, terms: tuple[str, ...], values: Mapping[str, float]) -> Candidate:
        if "smooth" in terms:
            raise RuntimeError("columns are dependent")
        return candidate(fits, terms, values)

    monkeypatch.setattr(Fits, "candidate", fitted)
    choice = choose(None, recorded(1e-3), linear_only=False)
    assert choice.sticking
    assert "coulomb" in choice.model.name.split("+")


@pytest.mark.study
def test_noise_that_hides_which_samples_are_slow_leaves_none_out() -> None:
    quiet = recorded(1e-3)
    noisy = replace(quiet, motion=replace(quiet.motion, rate_noise=1.0))
    assert not choose(model_of("linear+coulomb"), noisy, linear_only=False).sticking


@pytest.mark.study
def test_where_next_to_no_sample_is_fast_none_is_left_out_as_slow() -> None:
    """Six wild rates make all others slow beside them, and no model can be fitted to six samples."""
    motion = recorded(1e-3).motion
    wild = np.arange(len(motion)) < 6
    model = model_of("linear+coulomb")
    for fast, sticks in ((wild, False), (np.arange(len(motion)) < 2000, True)):
        moved = replace(motion, dtheta_dot=np.where(fast, 1e9, 1.0))
        assert _is_sticking(model.anchored(moved), moved, 0.0, np.where(fast, 1e-6, 1e-3)) == sticks


def test_the_passes_of_a_joint_are_counted_through_one_quarter_of_its_range() -> None:
    """A triangle passes there and back, whatever else it does; a joint that wanders seldom goes from end to end."""
    time = np.linspace(0.0, 1.0, 1000)
    triangle = np.interp(time, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0]) + 0.1 * np.sin(300.0 * time)
    none = np.zeros(1000)
    assert Motion(time, triangle, none, none, none).passes == 2
    assert Motion(time, 3.0 + np.sin(10.0 * np.pi * time), none, none, none).passes == 10
    wandering = np.interp(time, np.linspace(0.0, 1.0, 8), [0.0, 0.7, 0.1, 0.75, 0.15, 1.0, 0.6, 0.9])
    assert Motion(time, wandering, none, none, none).passes == 5


@pytest.mark.parametrize(("periods", "torque_from"), [(4, "joint"), (1, "motor")])
def test_the_terms_considered_are_those_that_the_motion_can_show_and_the_torque_can_have(
    monkeypatch: pytest.MonkeyPatch, periods: int, torque_from: str
) -> None:
    """A drift, and friction that grows with the load, show where the joint comes back again and again."""
    time, pace = np.linspace(0.0, 10.0, 1000), 2.0 * np.pi * periods / 10.0
    angle, rate = 0.3 * np.sin(pace * time), 0.3 * pace * np.cos(pace * time)
    motion = Motion(time, angle, rate, -(pace**2) * angle, np.zeros(len(time)))
    torque = KC * angle + 1e-4 * rate
    signals = Signals(motion, torque, Defects(), (0.1, 0.4), 0.0, torque_from)
    given: list[tuple[str, ...]] = []

    def plainest(_signals: Signals, _seen: object, *considered: tuple[str, ...]) -> Selection:
        given.extend(considered)
        raise RuntimeError

    monkeypatch.setattr(choosing, "_plainest", plainest)
    with pytest.raises(Untrustworthy, match="no model can be fitted"):
        choose(None, signals, linear_only=False)
    (terms,) = given
    assert len(set(terms)) == len(terms)
    assert {"drift", "softening", "sheath"}.intersection(terms) == (
        {"drift", "softening", "sheath"} if periods > 1 else set()
    )
    assert ("lag" in terms) == (torque_from != "motor")
