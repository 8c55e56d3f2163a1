"""Compare the lateness of `hil record` at 1 kHz with a bare loop in the same minute: python benchmarks/jitter.py

The recorder drives the simulated stand in real time, with the file and the live view on (standard error is a terminal
of its own). The bare loop sleeps to absolute times and does nothing else. They take turns. A second bare loop sleeps
and spins in the real-time class as the recorder does, where that is permitted. Prints
p50, p99 and the largest lateness and the ticks that were missed; ends with status 1 where the recorder's p99 is above
twice the bare loop's, or where it missed more than 0.1 % of its ticks although the real-time class is permitted.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.clock import MonotonicClock, machine_time
from drivers.servo import Status
from hil.acquisition.real_time import missing_permissions, real_time
from hil.recording.reader import Recording

Late = NDArray[np.float64]
MOST, MOST_MISSED = 2.0, 1e-3
CAT = [sys.executable, "-S", "-c", "import os\nwhile os.read(0, 4096): pass"]
RELAXED = (  # a busy computer may make a tick late: here it is counted, and ends nothing
    "from hil.acquisition import guard; from hil.cli.app import main\nguard._LATE_RAMP = guard._LATE_OFF = 60.0; main()"
)


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, default=1000.0, help="Hz")
    parser.add_argument("--seconds", type=float, default=5.0, help="of one turn")
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    count, rate = int(options.seconds * options.rate), options.rate
    late: dict[str, list[Late]] = {"bare loop": [], "hil record": [], "bare, as urgent": []}
    for _ in range(options.turns):
        late["bare loop"].append(bare(count, rate))
        late["hil record"].append(recorded(options.seconds, rate))
        with real_time(MonotonicClock()):
            late["bare, as urgent"].append(bare(count, rate, MonotonicClock()))
    table = {name: np.concatenate(turns) for name, turns in late.items()}
    print(f"{rate:g} Hz, {options.turns} turns of {options.seconds:g} s, load {os.getloadavg()[0]:.1f}")
    print(f"{'lateness':16} {'p50':>9} {'p99':>9} {'largest':>9} {'missed':>8}   us, share of the ticks")
    for name, one in table.items():
        p50, p99, most = (1e6 * value for value in (*np.quantile(one, [0.5, 0.99]), one.max()))
        print(f"{name:16} {p50:9.1f} {p99:9.1f} {most:9.1f} {missed(one, rate):8.3%}")
    return verdict(table, rate)


def verdict(table: dict[str, Late], rate: float) -> int:
    """Print the figures that have a bar, and return the exit status."""
    ratio = np.quantile(table["hil record"], 0.99) / np.quantile(table["bare loop"], 0.99)
    share, permitted = missed(table["hil record"], rate), "the real-time class" not in missing_permissions()
    breach = ratio > MOST or (permitted and share > MOST_MISSED)
    print(f"p99 of hil record is {ratio:.2f} times the bare loop's (bar: {MOST:g}); missed {share:.3%} of the ticks")
    print("BREACH" if breach else "no breach")
    return int(breach)


def missed(late: Late, rate: float) -> float:
    """Return the share of ticks that came a period or more late."""
    return float(np.mean(late >= 1.0 / rate))


def bare(count: int, rate: float, clock: MonotonicClock | None = None) -> Late:
    """Return the lateness, s, of a loop that only sleeps, with the standard library or with `clock`."""
    late = np.empty(count)
    start = machine_time() + 0.01
    for tick in range(count):
        due = start + tick / rate
        if clock is None:
            time.sleep(max(0.0, due - machine_time()))
        else:
            clock.sleep_until(due)
        late[tick] = machine_time() - due
    return late


def recorded(seconds: float, rate: float) -> Late:
    """Return the lateness, s, of the set-points of a run; of a tick that was missed, at least a period."""
    screen, terminal = os.openpty()
    with tempfile.TemporaryDirectory() as folder, subprocess.Popen(CAT, stdin=screen, stdout=-3) as watched:
        path = Path(folder) / "a.h5"
        words = ["record", "--backend", "sim", "--realtime", "--rate", str(rate), "--duration", str(seconds)]
        words += ["--band", "2:20", "-o", str(path)]
        subprocess.run([sys.executable, "-c", RELAXED, *words], stderr=terminal, stdout=-3, check=False)
        watched.kill()
        os.close(terminal)
        os.close(screen)
        with Recording(path) as recording:
            late = recording.channel("time") - np.arange(len(recording)) / rate
            gone = (recording.channel("status").astype(int) & int(Status.MISSED)) > 0
            return np.asarray(np.where(gone, np.maximum(late, 1.0 / rate), late))


if __name__ == "__main__":
    sys.exit(main())
