"""Recordings identified one by one: the same numbers in this process and in others."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hil.identification import each

from ..conftest import Hil, Maker


def without_time(text: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(text)
    for one in found["results"]:
        one.pop("seconds", None)
    return found


def files(make: Maker) -> list[Path]:
    return [make(f"r{i}.h5", samples=600, kc=0.02 + 0.001 * i, noise=1e-5, seed=i) for i in range(4)]


def test_each_recording_has_a_line_and_one_that_cannot_be_used_costs_the_others_nothing(
    hil: Hil, make_recording: Maker
) -> None:
    still = make_recording("still.h5", change=lambda channels: channels.update(dtheta=0.0 * channels["dtheta"]))
    ended = hil("identify", "--each", *files(make_recording)[:2], still, "--model", "linear", "--trials", 2)
    assert ended.status == 1
    assert [line.split(": Kc = ")[0][-5:] for line in ended.out.splitlines()] == ["r0.h5", "r1.h5"]
    assert f"error [unusable]: {still}" in ended.err


@pytest.mark.study
def test_other_processes_find_the_same_numbers(
    hil: Hil, make_recording: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["identify", "--each", *files(make_recording)[:3], "--model", "linear+offset", "--trials", 2, "--json"]
    here = hil(*words, "--workers", 1)
    monkeypatch.setattr(each, "_WORTH", 0.0)
    assert without_time(hil(*words, "--workers", 2).out) == without_time(here.out)


def test_an_option_of_one_identification_is_refused_with_each(hil: Hil, make_recording: Maker) -> None:
    ended = hil("identify", "--each", *files(make_recording)[:2], "--checkpoint", "a.npz")
    assert (ended.status, "--checkpoint" in ended.err) == (2, True)
