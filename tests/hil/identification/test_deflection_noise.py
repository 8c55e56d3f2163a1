"""Kc and Bc of recordings whose deflection is noisy or coarse, against a closed form."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import erf

from ga.model.coupling import parse
from hil.exchange.importer import Column, import_table
from hil.identification.candidates.choice import choose
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.reader import Array, Recording
from hil.recording.writer import Header, write
from hil.report.identification import deflection_lines
from hil.report.identification_json import deflection_json

from .conftest import SEARCH

SECONDS = 10.0
TIME = np.arange(round(500 * SECONDS)) / 500.0


def multisine() -> tuple[Array, Array]:
    phases = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 30)
    speeds = 2.0 * np.pi * np.geomspace(0.2, 12.0, 30)
    waves = np.exp(1j * (np.outer(TIME, speeds) + phases))
    return waves.real.sum(axis=1), (1j * speeds * waves).real.sum(axis=1)


def chirp() -> tuple[Array, Array]:
    growth = math.log(60.0) / SECONDS
    phase, speed = 2.0 * np.pi * 0.2 * np.expm1(growth * TIME) / growth, 0.4 * np.pi * np.exp(growth * TIME)
    return np.sin(phase), speed * np.cos(phase)


def binary() -> tuple[Array, Array]:
    """Random steps every 0.2 s, rounded by a Gaussian of 20 ms."""
    at, width = np.arange(0.0, SECONDS, 0.2), 0.02 * math.sqrt(2.0)
    steps = np.diff(np.random.default_rng(6).choice([-1.0, 1.0], len(at) + 1))
    apart = (TIME[:, None] - at) / width
    return 0.5 * erf(apart) @ steps, np.exp(-(apart**2)) @ steps / (width * math.sqrt(math.pi))


def jerky(hold: float = 0.2) -> tuple[Array, Array]:
    """Random steps every `hold` s through a second-order low-pass of 12 Hz: the acceleration jumps."""
    count = round(SECONDS / hold)
    since = np.maximum(TIME[:, None] - np.arange(count) * hold, 0.0)
    steps = np.diff(np.random.default_rng(6).choice([-1.0, 1.0], count + 1))
    speed, damped = 24.0 * math.pi, 0.8
    turning = math.sqrt(1.0 - damped**2)
    wave = np.exp((-damped + 1j * turning) * speed * since)
    return (1.0 - (wave.real + damped / turning * wave.imag)) @ steps, speed / turning * wave.imag @ steps


def quick() -> tuple[Array, Array]:
    return jerky(0.1)


Motion = Callable[[], tuple[Array, Array]]


def recorded(
    path: Path,
    motion: Motion = multisine,
    *,
    noise: float = 0.0,
    bits: int = 0,
    peak: float = 0.25,
    kc: float = 0.3,
    bc: float = 3e-3,
    torque_noise: float = 1e-3,
    commanded: bool = True,
    zero: float = 0.0,
    seed: int = 0,
    friction: float = 0.0,
    model: str | None = "linear+offset",
) -> Identification:
    """A model, or the one selected, of a recording with white noise of so many rad, or counts, in its deflection."""
    rng = np.random.default_rng([seed, 1])
    angle, rate = motion()
    scale = peak / float(np.abs(angle).max())
    angle, rate = scale * angle, scale * rate
    torque = kc * angle + bc * rate + friction * np.sign(rate) + torque_noise * rng.standard_normal(len(TIME))
    read = angle + noise * rng.standard_normal(len(TIME)) + zero
    count = 2.0 * math.pi / 2.0**bits
    channels = {"time": TIME, "torque": torque, "dtheta": count * np.round(read / count) if bits else read}
    write(path, Header(profile={}, stand_toml=""), channels | ({"command": angle} if commanded else {}), force=True)
    return identify([path], parse(model) if model else None, SEARCH)


def errors(found: Identification, kc: float = 0.3, bc: float = 3e-3) -> tuple[float, float]:
    return found["Kc"].value / kc - 1.0, found["Bc"].value / bc - 1.0


def holds(found: Identification, kc: float = 0.3, bc: float = 3e-3) -> bool:
    """Whether 1.5 times the intervals of Kc and Bc hold the truth."""
    apart = [(found[name].value - true, found[name].ci95) for name, true in (("Kc", kc), ("Bc", bc))]
    return all(abs(error) < 0.75 * (high - low) for error, (low, high) in apart)


def in_study(*given: object) -> Any:
    return pytest.param(*given, marks=pytest.mark.study)


CASES = [
    (5e-3, multisine, False),
    in_study(0.5e-3, multisine, True),
    in_study(2e-3, chirp, False),
    in_study(2e-3, binary, True),
]


@pytest.mark.parametrize(("noise", "motion", "commanded"), CASES)
def test_kc_and_bc_are_right_beside_white_noise(tmp_path: Path, noise: float, motion: Motion, commanded: bool) -> None:
    found = recorded(tmp_path / "a.h5", motion, noise=noise, commanded=commanded, seed=2)
    kc, bc = errors(found)
    assert abs(kc) < 5e-3
    assert abs(bc) < 0.03
    assert holds(found)


@pytest.mark.study
def test_averages_over_models_are_as_free_of_the_noise_as_the_model_selected(tmp_path: Path) -> None:
    """Noise changes a larger model by more: beside a skew it makes Kc too large."""
    found = [recorded(tmp_path / "a.h5", jerky, noise=5e-3, model=None, seed=seed) for seed in range(2)]
    assert abs(np.mean([errors(one)[0] for one in found])) < 1e-3
    assert all(holds(one) for one in found)


def misfits(found: Identification) -> bool:
    return any(one.code == "misfit" for one in found.diagnostics)


@pytest.mark.study
@pytest.mark.parametrize(
    ("motion", "friction", "commanded"), [(jerky, 0.0, True), (jerky, 0.0, False), (multisine, 2e-3, True)]
)
def test_a_low_pass_makes_no_misfit_of_jumps_that_the_torque_has(
    tmp_path: Path, motion: Motion, friction: float, commanded: bool
) -> None:
    """The deflection passes a low-pass for its noise: torque and friction have to pass it too."""
    model = "linear+offset+coulomb" if friction else "linear+offset"
    path = tmp_path / "a.h5"
    found = recorded(path, motion, noise=2e-3, friction=friction, model=model, commanded=commanded)
    assert found.deflection is not None
    assert found.deflection.low_pass is not None
    assert not misfits(found)
    assert abs(errors(found)[0]) < 5e-3
    assert abs(errors(found)[1]) < 0.03
    assert holds(found)


@pytest.mark.study
@pytest.mark.parametrize(
    ("motion", "bits", "seed", "commanded"), [(quick, 12, 2, True), (jerky, 11, 1, False), (quick, 11, 2, True)]
)
def test_counts_of_a_joint_that_rests_at_two_angles_are_no_misfit(
    tmp_path: Path, motion: Motion, bits: int, seed: int, commanded: bool
) -> None:
    """Every reading at rest is wrong by the same, and every transition is rounded alike: both go with the motion."""
    found = recorded(tmp_path / "a.h5", motion, bits=bits, seed=seed, commanded=commanded)
    assert not misfits(found)
    assert holds(found)


@pytest.mark.study
@pytest.mark.parametrize(
    ("motion", "bits", "noise", "commanded"),
    [(quick, 11, 0.0, True), (jerky, 12, 0.0, False), (jerky, 0, 2e-3, True), (jerky, 0, 2e-3, False)],
)
def test_counts_and_noise_of_the_deflection_hide_no_friction_that_the_model_lacks(
    tmp_path: Path, motion: Motion, bits: int, noise: float, commanded: bool
) -> None:
    path = tmp_path / "a.h5"
    assert misfits(recorded(path, motion, bits=bits, noise=noise, friction=5e-3, commanded=commanded))


@pytest.mark.study
def test_noise_makes_no_skew_and_no_lag_that_are_not_there(tmp_path: Path) -> None:
    signals = recorded(tmp_path / "a.h5", noise=5e-3).signals
    found = choose(None, signals, linear_only=False)
    assert found.model.name == "linear"


def test_a_stiff_joint_that_moves_by_few_hundred_counts_is_identified(tmp_path: Path) -> None:
    found = recorded(tmp_path / "a.h5", bits=17, peak=0.01, kc=500.0, bc=5.0, torque_noise=1e-2)
    kc, bc = errors(found, 500.0, 5.0)
    assert abs(kc) < 5e-3
    assert abs(bc) < 0.03
    assert holds(found, 500.0, 5.0)


def test_large_noise_is_taken_off_by_the_command_and_the_result_says_so(tmp_path: Path) -> None:
    found = recorded(tmp_path / "a.h5", noise=0.03, seed=2)
    assert found.deflection is not None
    assert found.deflection.method == "instruments"
    assert found.deflection.before["Kc"] < -0.002
    assert holds(found)
    assert found["Kc"].exact < found["Kc"].value  # the exact optimum knows no instruments
    (line,) = deflection_lines(found.deflection)
    assert re.match(r"the deflection has noise of (29|30|31) mrad", line)
    assert "corrected with the command as an instrument (before: Kc -" in line
    assert deflection_json(found.deflection)["instrument_strength"] > 0.9


@pytest.mark.study
def test_without_a_command_large_noise_is_simulated(tmp_path: Path) -> None:
    found = recorded(tmp_path / "a.h5", noise=0.03, commanded=False, seed=2)
    assert found.deflection is not None
    assert found.deflection.method == "simulation"
    assert holds(found)


@pytest.mark.study
def test_six_counts_without_a_command_are_too_few_for_bc(tmp_path: Path) -> None:
    found = recorded(tmp_path / "a.h5", chirp, bits=12, peak=0.0045, torque_noise=5e-5, commanded=False)
    assert not found.trusted("Bc")
    assert any("counts of the encoder. Bc cannot be identified" in one.message for one in found.diagnostics)


@pytest.mark.study
def test_a_far_zero_of_a_noisy_encoder_changes_nothing(tmp_path: Path) -> None:
    near, far = (recorded(tmp_path / "a.h5", noise=5e-3, zero=zero) for zero in (0.0, 4.0))
    assert near["Kc"].value == pytest.approx(far["Kc"].value, rel=1e-6)
    assert near["Bc"].value == pytest.approx(far["Bc"].value, rel=1e-5)


def as_table(recording: Path, columns: dict[str, str], command: Array | None = None) -> Identification:
    """A recording through a table of which some columns are named, with their unit, and back."""
    with Recording(recording) as read:
        channels = {name: read.channel(name) for name in ("time", "torque", "dtheta", "command")}
    rows = np.column_stack(list((channels | ({} if command is None else {"command": command})).values()))
    table, again = recording.with_suffix(".csv"), recording.with_name("b.h5")
    np.savetxt(table, rows, fmt="%.17g", delimiter=",", header=",".join(channels), comments="")
    import_table(table, again, {name: Column(name, unit) for name, unit in columns.items()}, [], force=True)
    return identify([again], parse("linear+offset"), SEARCH)


@pytest.mark.study
def test_the_command_of_a_table_serves_as_a_recorded_one_does(tmp_path: Path) -> None:
    path, read = tmp_path / "a.h5", {"time": "s", "torque": "N*m", "dtheta": "rad"}
    direct, without = recorded(path, noise=5e-3, seed=2), as_table(path, read)
    given = as_table(path, read | {"command": "A"})  # only its shape counts
    methods = [one.deflection.method for one in (given, without) if one.deflection is not None]
    assert methods == ["instruments", "simulation"]
    for name in ("Kc", "Bc"):
        assert given[name].value == pytest.approx(direct[name].value, rel=1e-9)
        assert given[name].ci95 == pytest.approx(direct[name].ci95, rel=1e-9)
        assert np.ptp(without[name].ci95) > np.ptp(given[name].ci95)


@pytest.mark.study
def test_a_command_that_the_motion_does_not_follow_is_warned_of_where_nothing_is_corrected_either(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.h5"
    recorded(path)
    columns = {"time": "s", "torque": "N*m", "dtheta": "rad", "command": "V"}
    noise = np.random.default_rng(3).standard_normal(len(TIME))
    found = as_table(path, columns, noise)
    assert [one.code for one in found.diagnostics] == ["deflection-noise"]
    assert found.dynamic_stiffness is not None
    assert found.dynamic_stiffness.instrument == "deflection"


@pytest.mark.study
def test_a_column_that_drove_nothing_is_noticed_as_no_command(tmp_path: Path) -> None:
    path, wandering = tmp_path / "a.h5", np.random.default_rng(3).standard_normal(len(TIME)).cumsum()
    recorded(path, noise=5e-3, seed=2)
    found = as_table(path, {"time": "s", "torque": "N*m", "dtheta": "rad", "command": "V"}, wandering)
    assert any(one.code == "deflection-noise" for one in found.diagnostics)
    assert holds(found)
