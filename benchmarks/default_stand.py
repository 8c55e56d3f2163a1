"""Whether intervals hold the truth on the default simulated stand: `python benchmarks/default_stand.py`.

The README's own commands with `--seeds` seeds: how many of the intervals hold Kc and Bc, those given the selected
model beside them, and how much wider the former are. Ends with 1 where an interval holds the truth in fewer than 93 or
more than 98 %, or is more than 2.5 times as wide as the conditional one.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hil.cli import app as cli

TRUTH = {"Kc": 17.75e-3, "Bc": 0.19e-3}
FEWEST, MOST, WIDEST = 0.93, 0.98, 2.5


def run(*words: str) -> str:
    """Return the standard output of a command."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO()):
        cli.run(list(words))
    return output.getvalue()


def record(path: Path, seed: int, profile: str = "chirp") -> None:
    """Record the default stand as the README does."""
    run("record", "--backend", "sim", "--profile", profile, "--seed", str(seed), "-o", str(path))


def identified(seed: int, profile: str) -> dict[str, Any]:
    """Return the JSON object of one recording of the default stand."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        record(path, seed, profile)
        found: dict[str, Any] = json.loads(run("identify", str(path), "--json", "--trials", "1", "--workers", "1"))
        return found


def table(found: list[dict[str, Any]]) -> tuple[list[str], bool]:
    """Return the lines of the table, and whether every bar is met."""
    lines = ["| | error, % | spread | half width | holds, % | conditional half width | holds, % | ratio |"]
    lines.append("|" + " --- |" * 8)
    met = True
    for name, truth in TRUTH.items():
        stated = [one["parameters"][name] for one in found if one["parameters"][name]["value"] is not None]
        values, low, high = (100.0 * (np.array(of) / truth - 1.0) for of in _numbers(stated))
        _, least, most = (100.0 * (np.array(of) / truth - 1.0) for of in _numbers([p["conditional"] for p in stated]))
        holds, held = (float(np.mean((a <= 0.0) & (b >= 0.0))) for a, b in ((low, high), (least, most)))
        half, narrow = 0.5 * float(np.mean(high - low)), 0.5 * float(np.mean(most - least))
        met &= FEWEST <= holds <= MOST and half <= WIDEST * narrow
        numbers = (np.mean(values), np.std(values), half, 100 * holds, narrow, 100 * held, half / narrow)
        lines.append(f"| {name} | " + " | ".join(f"{number:.3g}" for number in numbers) + " |")
    return lines, met


def _numbers(stated: list[dict[str, Any]]) -> tuple[list[float], list[float], list[float]]:
    return [p["value"] for p in stated], [p["ci95"][0] for p in stated], [p["ci95"][1] for p in stated]


def main() -> None:
    """Record, identify, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--profile", default="chirp", help="the README's is a chirp")
    options = parser.parse_args()
    found = [identified(seed, options.profile) for seed in range(options.first, options.first + options.seeds)]
    lines, met = table(found)
    print("\n".join(lines))
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
