"""Recordings identified one by one: the same numbers in this process, in others and on a Dask cluster."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from hil.child import command
from hil.identification import each

from ..conftest import Hil, Maker

MODEL = """
import os, pathlib, signal, sys
from typing import Annotated

PARENT = {parent}

def first():
    try:
        pathlib.Path({mark!r}).touch(exist_ok=False)
    except FileExistsError:
        return False
    return True

def dying(time, dtheta, dtheta_dot, *,
          Kc: Annotated[float, "N*m/rad", 0.0, 1.0], Bc: Annotated[float, "N*m*s/rad", 0.0, 0.01]):
    if PARENT != os.getpid() and {who}:
        os.kill(os.getpid(), signal.SIGKILL)
    return Kc * dtheta + Bc * dtheta_dot
"""


def without_time(text: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(text)
    for one in found["results"]:
        one.pop("seconds", None)
    return found


def files(make: Maker) -> list[Path]:
    return [make(f"r{i}.h5", samples=600, kc=0.02 + 0.001 * i, noise=1e-5, seed=i) for i in range(4)]


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[str]:
    """A scheduler and workers of Dask in processes of their own, on the loopback; yields the scheduler's address."""
    place = folder / "scheduler.json"
    scheduler = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(place)]
    worker = [
        "--scheduler-file",
        str(place),
        "--no-nanny",
        "--no-dashboard",
        "--nthreads",
        "1",
        "--death-timeout",
        "60",
    ]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with ExitStack() as stack:

        def start(module: str, words: list[str]) -> None:
            started = subprocess.Popen(command(module, *words), cwd=folder, **quiet)  # type: ignore[call-overload]
            stack.callback(started.wait)
            stack.callback(started.kill)

        start("distributed.cli.dask_scheduler", scheduler)
        for _ in range(workers):
            start("distributed.cli.dask_worker", worker)
        deadline = time.monotonic() + 60.0
        while not place.exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        yield str(json.loads(place.read_text())["address"])


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


def test_a_checkpoint_is_refused_with_a_cluster_that_would_not_write_it_here(hil: Hil, make_recording: Maker) -> None:
    ended = hil("identify", *files(make_recording)[:1], "--cluster", "local", "--checkpoint", "a.npz")
    assert (ended.status, "--checkpoint" in ended.err) == (2, True)


@pytest.mark.study
def test_a_scheduler_that_is_not_there_is_one_sentence(make_recording: Maker) -> None:
    words = ["identify", *files(make_recording)[:1], "--cluster", "tcp://127.0.0.1:9"]
    ended = subprocess.run([sys.executable, "-m", "hil", *map(str, words)], check=False, capture_output=True, text=True)
    assert ended.returncode == 2
    assert len(ended.stderr.splitlines()) == 1
    assert "no Dask scheduler answers there" in ended.stderr


def on_cluster(words: list[Any], address: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run hil in a process of its own, which gives up after 2 s without a worker."""
    main = (
        "import sys, hil.workers.cluster as cluster; from hil.cli import app\n"
        "cluster._WITHOUT_WORKERS = 2.0; sys.exit(app.run(sys.argv[1:]))"
    )
    words = [sys.executable, "-c", main, *map(str, words), "--cluster", address]
    return subprocess.run(words, check=False, capture_output=True, text=True, cwd=folder, timeout=180)


@pytest.mark.study
def test_a_cluster_finds_the_same_numbers_although_one_of_its_workers_is_killed_at_work(
    hil: Hil, make_recording: Maker, tmp_path: Path
) -> None:
    mark = tmp_path / "killed"
    (tmp_path / "model.py").write_text(MODEL.format(mark=str(mark), parent=os.getpid(), who="first()"))
    words = ["identify", "--each", *files(make_recording), "--model", "model.py:dying", "--trials", 2, "--json"]
    here = hil(*words, "--workers", 1)
    with cluster(tmp_path, workers=2) as address:
        ended = on_cluster(words, address, tmp_path)
    assert mark.exists()
    assert without_time(ended.stdout) == without_time(here.out)
    assert (ended.returncode, len(without_time(here.out)["results"])) == (here.status, 4)


@pytest.mark.study
def test_a_cluster_whose_workers_have_all_died_ends_in_one_sentence(make_recording: Maker, tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text(MODEL.format(mark="", parent=os.getpid(), who="'identify' not in sys.argv"))
    words = ["identify", "--each", *files(make_recording)[:2], "--model", "model.py:dying", "--trials", 2]
    with cluster(tmp_path, workers=1) as address:
        ended = on_cluster(words, address, tmp_path)
    assert ended.returncode == 2
    assert "no worker has been left" in ended.stderr.splitlines()[-1]
