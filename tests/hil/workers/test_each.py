"""Recordings identified one by one: the same numbers in this process and in others."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

import hil as api
from hil.identification import each

from ..conftest import Hil, Maker
from . import other_engines
from .other_engines import Unlucky, identified, table


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


def test_an_executor_finds_the_same_and_a_lost_process_costs_its_recording_only(make_recording: Maker) -> None:
    paths = files(make_recording)[:3]

    def die(_executor: Executor) -> Future[Any]:
        lost: Future[Any] = Future()
        lost.set_exception(OSError("worker 7 is gone"))
        return lost

    here = identified(paths, None)
    with ThreadPoolExecutor(1) as pool:
        assert [table(one) for one in identified(paths, pool)] == [table(one) for one in here]
        first, lost, last = identified(paths, Unlucky(pool, die))
    assert [first.digest, last.digest] == [here[0].digest, here[2].digest]
    assert isinstance(lost, api.NoResult)
    assert "was lost (OSError: worker 7 is gone), so Kc and Bc are unknown" in str(lost)
    with pytest.raises(api.WrongUse, match=r"takes no work .*has not been shut down"):
        identified(paths, pool)
    with pytest.raises(api.WrongUse, match=r"none\.h5 cannot be opened"), ThreadPoolExecutor(1) as pool:
        api.identify_each(["none.h5"], executor=pool)


@pytest.mark.study
@pytest.mark.parametrize("engine", ["pool", "dask"])
def test_other_engines_find_the_same_and_a_dead_process_costs_at_most_its_recording(
    make_recording: Maker, engine: str
) -> None:
    if engine == "dask" and find_spec("distributed") is None:
        pytest.skip("RECORDINGS NOT IDENTIFIED BY DASK: pip install 'hil[study]'")
    paths = files(make_recording)[:3]
    here = [table(one) for one in identified(paths, None)]
    ended = subprocess.run(
        [sys.executable, other_engines.__file__, engine, *paths],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    whole, (first, lost, last) = json.loads(ended.stdout)
    assert whole == json.loads(json.dumps(here))
    assert [first, last] == [whole[0], whole[2]]
    if engine == "pool":  # which breaks as a whole: processes of hil do what is left of it
        assert lost == whole[1]
    else:
        assert "was lost (KilledWorker: " in lost["errors"][0]["message"]


@pytest.mark.parametrize("distant", [False, True])
def test_ctrl_c_ends_the_work_with_the_results_that_are_there(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch, *, distant: bool
) -> None:
    monkeypatch.setattr("ga.trials.trials._POLL", 0.0)
    monkeypatch.setattr("ga.trials.trials._CHUNK", 1)

    def interrupt(what: str, _done: float) -> None:
        if what.startswith(("2 of 4: searching", "identified 1")):
            signal.raise_signal(signal.SIGINT)

    paths = files(make_recording)
    with ThreadPoolExecutor(1) as pool:
        first, *left = api.identify_each(
            paths, "linear", trials=1, workers=1, executor=pool if distant else None, progress=interrupt
        )
    assert isinstance(first, api.IdentificationResult)
    assert first["Kc"].value == pytest.approx(0.02, rel=0.01)
    assert all("Ctrl-C ended the work before" in str(one) for one in left)
    assert [one.recordings for one in left if isinstance(one, api.NoResult)] == [(path,) for path in paths[1:]]
