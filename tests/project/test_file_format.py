"""The page of the file format: its snippet in Python reads a recording, and its names are those of the file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hil.recording.writer import Header, write

PAGE = (Path(__file__).parents[2] / "docs" / "file_format.md").read_text(encoding="utf-8")


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    time = np.arange(50) / 100.0
    channels = {"time": time, "torque": 0.01 * time, "dtheta": 0.5 * time}
    write(tmp_path / "run1.h5", Header(profile={"kind": "imported"}, stand_toml="[stand]\n"), channels)
    return tmp_path / "run1.h5"


def snippet(language: str) -> str:
    found = re.search(rf"```{language}\n(.+?)```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_python_snippet_reads_a_recording(recording: Path) -> None:
    assert recording.exists()
    names: dict[str, Any] = {}
    exec(snippet("python"), names)  # noqa: S102 - our own page
    np.testing.assert_allclose(names["torque"], 0.01 * names["time"])
    np.testing.assert_allclose(names["dtheta"], 0.5 * names["time"])
    assert (names["unit"], names["stand"]) == ("N*m", "[stand]\n")


@pytest.mark.parametrize("language", ["matlab", "julia"])
def test_the_other_snippets_read_datasets_that_the_file_has(recording: Path, language: str) -> None:
    text = snippet(language)
    with h5py.File(recording) as file:
        for name in re.findall(r"/samples/(\w+)'", text):
            assert name in file["samples"]
        assert "unit" in file["samples/torque"].attrs
    assert all(name in text for name in ("time", "torque", "dtheta", "run1.h5"))
