"""How long the commands take, as a person waits for them: `python benchmarks/speed.py [--runs 3] [--write]`.

Each line is a whole command, imports included: the shortest of some runs by the clock, and the processor time of all
its processes, which other work on the machine changes less. The first run compiles into an empty cache. With --write it
writes results/commands.csv.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from page import machine, write_result

from ga.model.memory import lagged
from hil.recording.channels import ROW, Row
from hil.recording.writer import Header, RecordingWriter

HIL = [sys.executable, "-P", "-m", "hil"]
Cost = tuple[float, float]
"""s by the clock, and of processors."""


def cost(words: list[str], folder: Path, cache: Path, runs: int = 1) -> Cost:
    """The least of `runs` runs of a command."""
    found = []
    for _ in range(runs):
        began, before = time.perf_counter(), _processor()
        environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
        subprocess.run([*HIL, *words], cwd=folder, env=environment, capture_output=True, check=False)
        found.append((time.perf_counter() - began, _processor() - before))
    return min(found)


def _processor() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def make_viscoelastic(path: Path, samples: int = 10_000) -> None:
    """A spring and a damper with a Maxwell branch of a third of the stiffness: no usual term describes it."""
    time_, rng = np.arange(samples) / 500.0, np.random.default_rng(0)
    phases = rng.uniform(0.0, 2.0 * np.pi, 12)
    omega = 2.0 * np.pi * np.linspace(0.3, 12.0, 12)
    angle = 0.06 * np.sin(np.outer(time_, omega) + phases).sum(axis=1)
    rate = 0.06 * (omega * np.cos(np.outer(time_, omega) + phases)).sum(axis=1)
    rows = np.full(samples, np.array(Row(0), dtype=ROW))
    rows["seq"], rows["time"], rows["dtheta"] = np.arange(samples), time_, angle
    relaxing = angle - lagged(time_, angle, 0.03)
    rows["torque"] = 0.3 * angle + 3e-3 * rate + 0.1 * relaxing + 1e-3 * rng.standard_normal(samples)
    with RecordingWriter(path, Header(profile={"kind": "closed form"}), samples) as part:
        part.extend(rows)
        part.finish("done")


def measured(runs: int) -> Iterator[tuple[str, str, Cost]]:
    """What was timed, its bar, and its cost."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache = folder / "cache"
        record = ["record", "--backend", "sim", "--profile", "chirp", "--force"]
        cost([*record, "-o", "short.h5"], folder, cache)
        make_viscoelastic(folder / "viscoelastic.h5")
        identify, viscoelastic = ["identify", "short.h5"], ["identify", "viscoelastic.h5"]
        yield "`hil --version`", "", cost(["--version"], folder, cache, runs)
        yield "`hil identify`, 10,000 samples, the first run ever", "8 s", cost(identify, folder, cache)
        yield "the same again", "5 s", cost(identify, folder, cache, runs)
        report = [*identify, "--report", "report.html", "--force"]
        yield "with a report", "3 s more", cost(report, folder, cache, runs)
        cost(viscoelastic, folder, cache)  # compiles what only its terms need
        yield "a viscoelastic joint", "5 s", cost(viscoelastic, folder, cache, runs)
        minute = [*record, "--duration", "60", "-o", "minute.h5"]
        yield "`hil record`, 60 s at 500 Hz, in virtual time", "5 s", cost(minute, folder, cache, runs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--write", action="store_true", help="write results/commands.csv")
    given = parser.parse_args()
    lines = ["| command | bar | by the clock | processor time |", "| --- | --- | --- | --- |"]
    for what, bar, (clock, processor) in measured(given.runs):
        lines.append(f"| {what} | {bar} | {clock:.1f} s | {processor:.1f} s |")
        print(lines[-1], flush=True)
    if given.write:
        table = "\n".join(lines)
        write_result(
            "commands",
            "## How long the commands take\n\n"
            "`python benchmarks/speed.py --write` writes this file: whole commands, imports included, the "
            f"shortest of {given.runs} runs. The bars are by the clock on 2 idle cores.\n\n"
            f"Measured on {machine()}.\n\n{table}",
        )


if __name__ == "__main__":
    main()
