"""A user's own model, and everything that can be wrong with one."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hil.cli import app
from hil.errors import WrongUse
from hil.identification.compare import compare
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.identification.user_model import load

from ..conftest import Maker
from .conftest import SEARCH

GOOD = """
from typing import Annotated
import numpy as np

def joint(time, dtheta, dtheta_dot, *, Kc: Annotated[float, "N*m/rad", 0.0, 0.1],
          Bc: Annotated[float, "N*m*s/rad", 0.0, 2e-3]):
    return Kc * dtheta + Bc * dtheta_dot
"""


def written(folder: Path, text: str) -> str:
    path = folder / "model.py"
    path.write_text(text, encoding="utf-8")
    return f"{path}:joint"


def test_it_comes_to_what_the_linear_model_comes_to(sound: Identification, tmp_path: Path) -> None:
    own = identify(list(sound.recordings), load(written(tmp_path, GOOD)), SEARCH)
    assert [estimate.unit for estimate in own.estimates] == ["N*m/rad", "N*m*s/rad"]
    for one, other in zip(own.estimates, sound.estimates, strict=True):
        assert one.value == pytest.approx(other.value, rel=1e-5)
        assert one.optimiser.best == pytest.approx(other.optimiser.best, rel=1e-4)
        assert one.ci95 == pytest.approx(other.ci95, rel=1e-3)
        assert one.identifiable


@pytest.mark.study
def test_one_without_kc_and_bc_that_does_not_describe_the_recording_is_not_trusted(
    make_recording: Maker, tmp_path: Path
) -> None:
    def stiffens(channels: dict[str, np.ndarray]) -> None:
        channels["torque"] += 0.02 * channels["dtheta"] ** 3

    path = make_recording(noise=2e-5, samples=8000, change=stiffens)
    found = identify([path], load(written(tmp_path, GOOD.replace("Kc", "stiff").replace("Bc", "damped"))), SEARCH)
    (misfit,) = (one for one in found.diagnostics if one.code == "misfit")
    assert misfit.is_error
    assert "so its parameters may be wrong" in misfit.message
    assert not {"Kc", "Bc"}.intersection(re.findall(r"\w+", misfit.message))
    assert not found.trusted("stiff")


@pytest.mark.study
@pytest.mark.parametrize(("required", "status"), [("Kc", 1), ("both", 0)])
def test_a_parameter_that_is_required_and_missing_is_not_trusted(
    make_recording: Maker, tmp_path: Path, capfd: pytest.CaptureFixture[str], required: str, status: int
) -> None:
    own = written(tmp_path, GOOD.replace("Kc", "stiff").replace("Bc", "damped"))
    path = str(make_recording(samples=600, noise=1e-4))
    assert app.run(["identify", path, "--model", own, "--trials", "1", "--require", required]) == status
    assert ("has no Kc, which --require asks for" in capfd.readouterr().err) is (status == 1)


@pytest.mark.study
def test_its_validation_error_is_relative_to_the_torque(make_recording: Maker, tmp_path: Path) -> None:
    """The stiffness is 2500 Kc^3, whose linearisation is three times as large: white noise over the torque's RMS."""
    noise, path = 2e-4, make_recording(noise=2e-4, samples=1500)
    own = identify([path], load(written(tmp_path, GOOD.replace("Kc * dtheta", "2500 * Kc**3 * dtheta"))), SEARCH)
    assert own["Kc"].value == pytest.approx(0.02, rel=1e-3)
    assert own.validation.nrmse == pytest.approx(noise / float(np.std(own.signals.torque)), rel=0.05)
    assert own.validation.fitness == pytest.approx(noise * np.sqrt(2.0 / np.pi), rel=0.05)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("return Kc", "raise KeyError('x')\n    return Kc"), "raised KeyError"),
        (("return Kc * dtheta", "return np.nan * dtheta"), "not a number"),
        (("return Kc * dtheta + Bc * dtheta_dot", "return 1.0"), r"gave \(\) for"),
        (("return Kc", "dtheta *= 2.0\n    return Kc"), "raised ValueError: .*read-only"),
        (("return Kc", "raise SystemExit(0)\n    return Kc"), "raised SystemExit"),
        (("return Kc * dtheta + Bc * dtheta_dot", "return None"), "gave object and not real numbers"),
        (
            ("return Kc", "if Kc < 0.04:\n        return np.nan * dtheta\n    return Kc"),
            "not a number; at Kc = 0.0[0-3]",
        ),
        (("import numpy as np", "raise SystemExit(0)"), "raised SystemExit"),
        (("0.0, 0.1]", "0.1, 0.0]"), "low below high"),
        (("def joint", "def other"), "has no function joint"),
        (("import numpy as np", "import nothing_of_that_name"), "raised ModuleNotFoundError"),
    ],
)
def test_what_is_wrong_with_it_is_said_in_a_sentence(
    make_recording: Maker, tmp_path: Path, change: tuple[str, str], said: str
) -> None:
    path = make_recording(samples=600, noise=1e-4)
    with pytest.raises(WrongUse, match=said):
        identify([path], load(written(tmp_path, GOOD.replace(*change))), SEARCH)


def test_a_file_that_is_not_there_is_said() -> None:
    with pytest.raises(WrongUse, match=r"there is no file nowhere\.py"):
        load("nowhere.py:joint")


def test_to_read_it_leaves_nothing_beside_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    load(written(tmp_path, GOOD))
    assert [one.name for one in tmp_path.iterdir()] == ["model.py"]


@pytest.mark.parametrize("unit", ["N*m/rad", "N m/rad", "Nm/rad", "mN*m/rad", "N*m"])
def test_the_uncertainty_of_the_torque_is_carried_into_what_scales_with_it(tmp_path: Path, unit: str) -> None:
    own = load(written(tmp_path, GOOD.replace('"N*m/rad"', f'"{unit}"').replace('"N*m*s/rad"', '"s"')))
    assert [parameter.scales for parameter in own.nonlinear] == [True, False]


@pytest.mark.study
def test_a_model_without_kc_and_bc_is_identified_and_cannot_be_compared(make_recording: Maker, tmp_path: Path) -> None:
    own = load(written(tmp_path, GOOD.replace("Kc", "k").replace("Bc", "b")))
    paths = [make_recording(f"{seed}.h5", samples=600, noise=1e-4, seed=seed) for seed in range(2)]
    assert [estimate.name for estimate in identify(paths, own, SEARCH).estimates] == ["k", "b"]
    with pytest.raises(WrongUse, match="has k, b: give its parameters"):
        compare(paths, own, SEARCH)
