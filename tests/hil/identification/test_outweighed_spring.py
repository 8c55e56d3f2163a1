"""A Kc that rests on less torque than the model leaves unexplained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.reader import Array
from hil.recording.writer import Header, write

SEARCH = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
TIME = np.arange(5000) / 250.0


def recording(path: Path, time: Array, torque: Array, deflection: Array) -> Path:
    write(
        path,
        Header(profile={"kind": "prescribed"}, stand_toml=""),
        {"time": time, "torque": torque, "dtheta": deflection},
    )
    return path


def rubbing(path: Path, stiffness: float, ripple: float, noise: float = 5e-3) -> Identification:
    """A joint with 1 N m of dry friction, and a ripple of `ripple` N m that repeats every 60 mrad of its 0.5 rad."""
    deflection = 0.17 * np.sin(1.3 * TIME) + 0.08 * np.sin(7.9 * TIME)
    rate = 0.17 * 1.3 * np.cos(1.3 * TIME) + 0.08 * 7.9 * np.cos(7.9 * TIME)
    torque = stiffness * deflection + 0.02 * rate + np.sign(rate) + ripple * np.sin(2.0 * np.pi * deflection / 0.06)
    torque += noise * np.random.default_rng(3).standard_normal(len(TIME))
    return identify([recording(path, TIME, torque, deflection)], parse("linear+offset+coulomb"), SEARCH)


def locked(seed: int, peak: float) -> tuple[Array, Array, Array]:
    """Time, torque and angle of a motor on a locked gear that `peak` N m drive up and down once in 4 s.

    Its 400 N m/rad act beyond a play of 30 mrad. Friction of 1.7 N m builds up over 0.3 mrad, and the teeth make a
    ripple of 0.8 N m every 8 mrad: 4 N m hardly load the spring.
    """
    rng, rate, finer, angle, speed, state = np.random.default_rng(seed), 430.0, 40, 0.0, 0.0, 0.0
    count, step, phase, angles = round(4.0 * rate), 1.0 / (rate * finer), rng.uniform(0.0, 2.0 * np.pi), []
    drive = peak * (4.0 * np.abs((np.arange(count * finer) * step / 4.0 + 0.75) % 1.0 - 0.5) - 1.0)
    for at, torque in enumerate(drive.tolist()):
        load = 400.0 * float(np.sign(angle)) * max(abs(angle) - 0.015, 0.0) + 1.7 * state + 2.0 * speed
        speed += step * (torque - load - 0.8 * float(np.sin(2.0 * np.pi * angle / 0.008 + phase))) / 0.003
        way = 1.0 if speed > 0.0 else -1.0
        state = way + (state - way) * float(np.exp(-abs(speed * step) / 3e-4))
        angle += speed * step
        if at % finer == 0:
            angles.append(angle)
    lsb = 2.0 * np.pi / 2.0**16
    read = drive[::finer] + 0.1 * rng.standard_normal(count)
    return np.arange(count) / rate, read, lsb * np.round((angles + 2e-5 * rng.standard_normal(count)) / lsb)


def codes(found: Identification) -> list[str]:
    return [one.code for one in found.diagnostics if one.is_error and one.parameter == "Kc"]


@pytest.mark.parametrize(("stiffness", "refused"), [(1.0, True), (10.0, False)])
def test_a_spring_that_carries_less_than_what_nothing_explains_has_no_stiffness(
    tmp_path: Path, stiffness: float, *, refused: bool
) -> None:
    found = rubbing(tmp_path / "a.h5", stiffness, 0.12)
    assert found.lack_of_fit is not None
    assert found.lack_of_fit.misfit
    assert ("spring-outweighed" in codes(found)) is refused


def test_a_stiffness_that_would_be_negative_has_a_wrong_sign_and_no_advice_to_drive_harder(tmp_path: Path) -> None:
    found = rubbing(tmp_path / "a.h5", -1.0, 0.12)
    assert found["Kc"].value == 0.0
    assert codes(found) == ["implausible"]
    assert not found.trusted("Kc")


def test_noise_larger_than_the_torque_of_the_spring_is_averaged_away(tmp_path: Path) -> None:
    found = rubbing(tmp_path / "a.h5", 1.5, 0.06, noise=0.15)
    assert found.lack_of_fit is not None
    assert found.lack_of_fit.misfit
    assert "spring-outweighed" not in codes(found)
    assert found["Kc"].value == pytest.approx(1.5, abs=0.15)


def test_a_locked_gear_that_hardly_leaves_its_play_has_no_stiffness(tmp_path: Path) -> None:
    found = identify([recording(tmp_path / "a.h5", *locked(1, 4.0))], parse("linear+offset+dahl+backlash"), SEARCH)
    assert found["Kc"].value > 2.0 * 400.0
    assert "spring-outweighed" in codes(found)
    assert not found.trusted("Kc")
    message = next(one.message for one in found.diagnostics if one.code == "spring-outweighed")
    assert "Drive with several times the torque" in message


def loaded(seed: int) -> tuple[Array, Array, Array]:
    """Time, torque and angle of a gear that is turned up and down once in 20 s, against friction that grows with load.

    Its 300 N m/rad act beyond a play of 30 mrad. Friction of 3 N m and a quarter of the spring's torque builds up over
    4 mrad, from one step to the next.
    """
    rng, rate, finer, state = np.random.default_rng(seed), 200.0, 16, 0.0
    way = np.arange(round(20.0 * rate) * finer) / (20.0 * rate * finer)
    angle = 0.07 * np.interp(way, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
    for cycles in rng.uniform(6.0, 100.0, 12):
        angle += 3e-4 * rng.standard_normal() * np.sin(2.0 * np.pi * (cycles * way + rng.uniform()))
    load = 300.0 * np.sign(angle) * np.maximum(np.abs(angle) - 0.015, 0.0)
    states = np.empty(len(angle))
    for at, moved in enumerate(np.diff(angle, prepend=angle[0]).tolist()):
        ahead = 1.0 if moved > 0.0 else -1.0
        states[at] = state = ahead + (state - ahead) * float(np.exp(-abs(moved) / 0.004))
    torque = (load + (3.0 + 0.25 * np.abs(load)) * states)[::finer]
    lsb = 2.0 * np.pi / 2.0**16
    noise = 0.08 * rng.standard_normal(len(torque))
    return np.arange(len(torque)) / rate, torque + noise, lsb * np.round(angle[::finer] / lsb)


def test_friction_of_a_gear_that_grows_with_its_load_shows_in_one_triangle(tmp_path: Path) -> None:
    found = identify([recording(tmp_path / "a.h5", *loaded(1))], None, SEARCH)
    assert found.model.name == "linear+offset+backlash+gear"
    assert found["Kc"].value == pytest.approx(300.0, rel=0.01)
    assert found["Kc"].ci95[0] < 300.0 < found["Kc"].ci95[1]
    assert found["mu"].value == pytest.approx(0.25, abs=0.02)
    assert found.trusted("Kc")
