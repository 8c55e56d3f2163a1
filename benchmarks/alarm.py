"""Cut the link of `hil record` in the middle of a run and measure the time until CUT THE POWER is on the terminal.

python benchmarks/alarm.py --times 3 [--adapter "cia402 EPOS4, no watchdog" ...] [--write]

The drives are the emulated ones of benchmarks/killing.py. "silent": the drive answers no more, as with its cable pulled
at the drive (SIGSTOP to the emulator). "gone": the port or adapter is gone (SIGKILL). The time begins at the cut, so
that it contains the lost replies after which hil requests torque-off, about 0.1 s. Ends with status 1 where one is
longer than 1.5 s.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from killing import ADAPTERS, Adapter, EndedBefore, Log, await_torque, emulated, prepare, recorded

BAR, PATIENCE = 1.5, 60.0  # s
CUTS = {"silent": signal.SIGSTOP, "gone": signal.SIGKILL}
RESULTS = Path(__file__).parent / "results" / "alarm.csv"


def children() -> set[int]:
    """Return the processes that this one has started and that still run."""
    return {int(word) for word in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()}


def trial(adapter: Adapter, cut: str, wait: float, settings: argparse.Namespace) -> float:
    """Return the time from the cut to the alarm, s; infinity without one. Raises EndedBefore."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(adapter, folder, folder / "tty")
        before = children()
        with emulated(adapter, folder / "tty", folder / "torque.csv"):
            (emulator,) = children() - before
            begun, output = time.monotonic(), folder / "run.h5"
            process = recorded(adapter, folder / "stand.toml", output, "plain", settings)
            try:
                await_torque(Log(folder / "torque.csv"), process, begun, 0.25 * adapter.torque)
                time.sleep(wait)
                return alarmed(process, output.with_suffix(".log"), lambda: os.kill(emulator, CUTS[cut]))
            finally:
                process.kill()
                process.wait()


def alarmed(process: subprocess.Popen[bytes], log: Path, cut: Callable[[], object]) -> float:
    """Cut the link by calling `cut`, and return the s until the alarm is in `log`."""
    if process.poll() is not None:
        raise EndedBefore
    begun = time.monotonic()
    cut()
    while time.monotonic() < begun + PATIENCE:
        if b"CUT THE POWER" in log.read_bytes():
            return time.monotonic() - begun
        if process.poll() is not None:
            break
        time.sleep(5e-3)
    return math.inf


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--adapter", nargs="+", default=[one.name for one in ADAPTERS])
    parser.add_argument("--write", action="store_true", help="write results/alarm.csv")
    settings = parser.parse_args()
    settings.rate, settings.patient, settings.python, settings.no_guardian = 100.0, True, False, False
    rng = random.Random(1)  # noqa: S311 - no secret
    lines, worst = ["drive,link,trials,median s,worst s"], 0.0
    for adapter in (one for one in ADAPTERS if one.name in settings.adapter):
        for cut in CUTS:
            times: list[float] = []
            for _ in range(4 * settings.times):
                with suppress(EndedBefore):
                    times.append(trial(adapter, cut, rng.uniform(0.0, 0.8), settings))
                if len(times) == settings.times:
                    break
            row = [f'"{adapter.name}"', cut, f"{len(times)}", f"{statistics.median(times):.2f}", f"{max(times):.2f}"]
            lines.append(",".join(row))
            worst = max(worst, *times)
            print(lines[-1], flush=True)
    if settings.write:
        load = f"load {os.getloadavg()[2]:.0f} on {os.cpu_count()} cores"
        head = f"# python benchmarks/alarm.py --times {settings.times}; s from the cut to the alarm, {load}"
        RESULTS.write_text("\n".join([head, *lines]) + "\n", encoding="ascii")
    return int(worst > BAR)


if __name__ == "__main__":
    sys.exit(main())
