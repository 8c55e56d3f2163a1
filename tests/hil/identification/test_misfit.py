from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.cli import app
from hil.recording.writer import Header, write

Array = NDArray[np.float64]

KC, BC = 0.3, 3e-3
TIME = np.arange(5000) / 500.0


def multisine(time: Array) -> tuple[Array, Array]:
    """A deflection, rad, and its rate, rad/s."""
    speeds = 2.0 * np.pi * np.geomspace(0.4, 12.0, 20)
    waves = 0.02 * np.exp(1j * (np.outer(time, speeds) + np.arange(20) ** 2))
    return waves.real.sum(axis=1), -(waves.imag @ speeds)


def recording(path: Path, torque: Array, samples: int = 5000, seed: int = 0) -> Path:
    noise = 5e-4 * np.random.default_rng(seed).standard_normal(samples)
    deflection = multisine(TIME[:samples])[0]
    channels = {"time": TIME[:samples], "torque": torque[:samples] + noise, "dtheta": deflection}
    write(path, Header(profile={"kind": "prescribed"}, stand_toml=""), channels | {"command": deflection})
    return path


def plain() -> Array:
    deflection, rate = multisine(TIME)
    return KC * deflection + BC * rate


def sheathed() -> Array:
    """A tendon whose friction is a tenth of what it carries."""
    return plain() * (1.0 + 0.1 * np.tanh(multisine(TIME)[1] / 1e-2) * np.sign(plain()))


def identified(capfd: pytest.CaptureFixture[str], path: Path, *options: str) -> tuple[int, dict[str, Any]]:
    status = app.run(["identify", str(path), "--json", "--trials", "2", "--workers", "1", *options])
    return status, json.loads(capfd.readouterr().out)


def test_a_joint_that_the_model_describes_has_no_misfit(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    status, found = identified(capfd, recording(tmp_path / "a.h5", plain()))

    assert status == 0
    assert not found["lack_of_fit"]["misfit"]


def test_the_stiffness_without_a_model_is_in_the_json(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    _, found = identified(capfd, recording(tmp_path / "a.h5", plain()))

    dynamic = found["dynamic_stiffness"]
    assert dynamic["instrument"] == "command"
    assert dynamic["stiffness"] == pytest.approx([KC] * len(dynamic["stiffness"]), rel=0.02)


def test_a_misfit_ends_with_status_1_and_names_the_effect(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    status, found = identified(capfd, recording(tmp_path / "a.h5", sheathed()))

    assert status == 1
    message = next(one["message"] for one in found["errors"] if one["code"] == "misfit")
    assert "friction in proportion to the torque" in message
    assert "Kc may be wrong by" in message


def test_a_users_own_model_is_tested_too(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "own.py").write_text(
        "from typing import Annotated\n\n\n"
        'def own(time, dtheta, dtheta_dot, *, Kc: Annotated[float, "N*m/rad", 0.0, 1.0],\n'
        '        Bc: Annotated[float, "N*m*s/rad", 0.0, 0.01]):\n'
        "    return Kc * dtheta + Bc * dtheta_dot\n"
    )
    model = f"{tmp_path / 'own.py'}:own"

    described = identified(capfd, recording(tmp_path / "a.h5", plain()), "--model", model)[1]
    lacking = identified(capfd, recording(tmp_path / "b.h5", sheathed()), "--model", model)[1]

    assert [one["lack_of_fit"]["misfit"] for one in (described, lacking)] == [False, True]


def test_a_recording_too_short_for_the_test_is_warned_of(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = recording(tmp_path / "a.h5", plain(), samples=350)

    _, found = identified(capfd, path, "--model", "linear")

    assert found["lack_of_fit"] is None
    assert "misfit-untested" in [one["code"] for one in found["warnings"]]


def test_the_report_draws_the_test(tmp_path: Path) -> None:
    page = tmp_path / "page.html"

    app.run(["identify", str(recording(tmp_path / "a.h5", sheathed())), "--trials", "1", "--report", str(page)])

    assert page.with_suffix(".png").stat().st_size > 10_000
