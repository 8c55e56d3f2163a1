"""How much faster two processes identify twenty recordings than one: `hil identify --each --workers 2`.

python benchmarks/spread.py [recordings] [seconds of each]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import hil


def seconds(paths: list[Path], workers: int) -> tuple[float, list[dict[str, Any]]]:
    words = ["identify", "--each", *map(str, paths), "--model", "linear+offset+coulomb+skew", "--json"]
    began = time.perf_counter()
    ended = subprocess.run(
        [sys.executable, "-m", "hil", *words, "--workers", str(workers)], check=False, capture_output=True, text=True
    )
    took = time.perf_counter() - began
    found: list[dict[str, Any]] = json.loads(ended.stdout)["results"]
    return took, [{name: value for name, value in one.items() if name != "seconds"} for one in found]


def main(count: int, duration: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{number}.h5" for number in range(count)]
        for number, path in enumerate(paths):
            hil.simulate(path, seed=number, duration=duration)
        hil.identify(paths[0], model="linear+offset+coulomb+skew")  # compiled before the clock runs
        one, first = seconds(paths, 1)
        two, second = seconds(paths, 2)
        print(f"{count} recordings: {one:.1f} s with one worker, {two:.1f} s with two: {one / two:.2f} times as fast")
        print("same numbers" if first == second else "OTHER NUMBERS")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, float(sys.argv[2]) if len(sys.argv) > 2 else 20.0)
