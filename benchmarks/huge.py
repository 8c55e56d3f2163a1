"""Recordings larger than memory, identified exactly: `python benchmarks/huge.py [--samples N ...] [--folder DIR]`.

Makes a recording of a prescribed deflection with a torque in closed form, block by block, then runs `hil identify` on
it as a process of its own and asks the system how much memory that took. Writes results/huge.csv.
With 100,000,000 samples it wants 25 GB of disk and a quarter of an hour; an earlier recording spares the making.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from page import machine, write_result

from hil.recording.channels import ROW, Row
from hil.recording.writer import Header, RecordingWriter

RATE, KC, BC = 500.0, 17.75e-3, 0.19e-3
BLOCK = 1 << 18
COMPILED = 20_000  # samples, of a run that is not timed


def make(path: Path, samples: int) -> None:
    """Two sines of 0.3 and 7.3 Hz, a 14-bit encoder, 0.2 mN m of noise."""
    rng = np.random.default_rng(0)
    count = 2.0 * np.pi / 2**14
    with RecordingWriter(path, Header(profile={"kind": "closed form"}), samples) as part:
        for start in range(0, samples, BLOCK):
            number = np.arange(start, min(start + BLOCK, samples))
            at = number / RATE
            slow, fast = 2.0 * np.pi * 0.3, 2.0 * np.pi * 7.3
            dtheta = 0.2 * np.sin(slow * at) + 0.1 * np.sin(fast * at)
            velocity = 0.2 * slow * np.cos(slow * at) + 0.1 * fast * np.cos(fast * at)
            rows = np.full(len(at), np.array(Row(0), dtype=ROW))
            rows["seq"], rows["time"] = number, at
            rows["dtheta"] = np.round(dtheta / count) * count
            rows["torque"] = KC * dtheta + BC * velocity + 2e-4 * rng.standard_normal(len(at))
            part.extend(rows)
            if start // BLOCK % (samples // BLOCK // 10 + 1) == 0:
                print(f"made {start + len(rows):,} of {samples:,} samples", flush=True)
        print("packing them", flush=True)
        part.finish("done")


class Cost(NamedTuple):
    """s by the clock and of the processor, and GiB that were resident at the most."""

    clock: float
    processor: float
    memory: float


def identified(path: Path) -> tuple[dict[str, Any], Cost]:
    """What `hil identify --json` found in a process of its own, and what that cost."""
    command = [sys.executable, "-c", "from hil.cli.app import main; main()", "identify", str(path), "--json"]
    began = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        found = json.loads(process.stdout.read())
        _, _, usage = os.wait4(process.pid, 0)
        process.returncode = 0
    return found, Cost(time.perf_counter() - began, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20)


def row(found: dict[str, Any], size: int, cost: Cost) -> str:
    """A row of the table: what was found in a recording of `size` bytes, and what that cost."""
    kc, bc = (found["parameters"][parameter]["value"] for parameter in ("Kc", "Bc"))
    return (
        f"| {found['samples']:,} | {size / 1e9:.2f} GB | {cost.clock:.0f} s | {cost.processor:.1f} s | "
        f"{cost.memory:.2f} GiB | {kc * 1e3:.5f} | {bc * 1e3:.6f} | {found['fitness']['optimiser_gap']:.1e} |"
    )


def report(rows: list[str]) -> None:
    text = (
        "## A recording larger than memory\n\n"
        "`python benchmarks/huge.py` writes this file. A recording of two sines with a 14-bit encoder and 0.2 mN m "
        f"of noise, made with Kc = {KC * 1e3:g} mN m/rad and Bc = {BC * 1e3:g} mN m s/rad, identified as a process of "
        "its own. The bars, by the clock on 2 idle cores, are 10 s for 10,000,000 samples, and 150 s and 1 GiB for "
        f"100,000,000.\n\nMeasured on {machine()}.\n\n"
        "| samples | file | by the clock | processor time | resident | Kc, mN m/rad | Bc, mN m s/rad | gap |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- |\n" + "\n".join(rows)
    )
    print(text)
    write_result("huge", text)


def measured(path: Path) -> str:
    found, cost = identified(path)
    return row(found, path.stat().st_size, cost)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--samples", type=int, nargs="+", default=[10_000_000, 100_000_000])
    arguments.add_argument("--folder", type=Path, default=None, help="where the recordings are made")
    arguments.add_argument("--recording", type=Path, nargs="+", default=[], help="those that were made before")
    given = arguments.parse_args()
    if given.recording:
        report([measured(path) for path in given.recording])
        return
    rows = []
    with tempfile.TemporaryDirectory(dir=given.folder) as name:
        short = Path(name) / "short.h5"
        make(short, COMPILED)
        identified(short)  # the first run ever compiles
        for samples in given.samples:
            path = Path(name) / "huge.h5"
            make(path, samples)
            rows.append(measured(path))
            path.unlink()
    report(rows)


if __name__ == "__main__":
    main()
