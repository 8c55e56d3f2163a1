"""A Kc that rests on less torque than the model leaves unexplained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ga.model.coupling import parse
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.reader import Array
from hil.recording.writer import Header, write

from .conftest import SEARCH

TIME = np.arange(2500) / 125.0


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


def codes(found: Identification) -> list[str]:
    return [one.code for one in found.diagnostics if one.is_error and one.parameter == "Kc"]


@pytest.mark.study
def test_a_spring_that_carries_less_than_what_nothing_explains_has_no_stiffness(tmp_path: Path) -> None:
    found = rubbing(tmp_path / "a.h5", 1.0, 0.12)
    assert found.lack_of_fit is not None
    assert found.lack_of_fit.misfit
    (said,) = [one for one in found.diagnostics if one.code == "little-load" and one.is_error]
    assert (said.parameter, said.is_error) == ("Kc", True)
    assert "Drive with several times the torque" in said.message


def test_a_stiffness_that_would_be_negative_has_a_wrong_sign_and_no_advice_to_drive_harder(tmp_path: Path) -> None:
    found = rubbing(tmp_path / "a.h5", -1.0, 0.12)
    assert found["Kc"].value == 0.0
    assert codes(found) == ["implausible"]
    assert not found.trusted("Kc")


@pytest.mark.study
def test_noise_larger_than_the_torque_of_the_spring_is_averaged_away(tmp_path: Path) -> None:
    found = rubbing(tmp_path / "a.h5", 1.5, 0.06, noise=0.15)
    assert found.lack_of_fit is not None
    assert found.lack_of_fit.misfit
    assert "little-load" not in codes(found)
    assert found["Kc"].value == pytest.approx(1.5, abs=0.15)
