"""How long the commands take, as a person waits for them: `python benchmarks/speed.py`.

Each line is a whole command, imports included, best of five; the first run of `identify` compiles the search into an
empty cache. What is printed belongs to the machine it ran on.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RUNS = 5
HIL = [sys.executable, "-c", "from hil.cli.app import main; main()"]


def seconds(words: list[str], folder: Path, cache: Path, runs: int = RUNS) -> float:
    """The shortest of `runs` runs of a command, s."""
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        subprocess.run(
            [*HIL, *words],
            cwd=folder,
            env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
            stdout=subprocess.DEVNULL,
            check=True,
        )
        times.append(time.perf_counter() - began)
    return min(times)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cold, warm = folder / "cold", folder / "warm"
        record = ["record", "--backend", "sim", "--profile", "chirp", "--force"]
        minute = [*record, "--duration", "60", "-o", "minute.h5"]
        identify = ["identify", "short.h5", "--trials", "30"]
        first_record = seconds(minute, folder, cold, 1)
        seconds([*record, "--duration", "19.998", "-o", "short.h5"], folder, cold, 1)
        first_identify = seconds(identify, folder, cold, 1)
        for words in (minute, identify):
            seconds(words, folder, warm, 1)
        print(
            f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
        )
        for what, bar, took in (
            ("hil --help", 0.3, seconds(["--help"], folder, warm)),
            ("hil record, 60 s at 500 Hz, virtual time", 5.0, seconds(minute, folder, warm)),
            ("the same, very first run", None, first_record),
            ("hil identify, 10,000 samples, 30 trials", 2.0, seconds(identify, folder, warm)),
            ("the same, very first run", 15.0, first_identify),
        ):
            print(f"{what:45} {took:7.2f} s" + (f"   (bar: {bar:g} s)" if bar else ""))


if __name__ == "__main__":
    main()
