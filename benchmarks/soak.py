"""Record for hours in virtual time: python benchmarks/soak.py --hours 8

Records a sine on the simulated stand at 1 kHz in a process of its own, and then looks at the recording: every row is
there in order and as it was written, no reply is missing but those that the simulated link loses, the motor's torque
and the deflection keep their size from the first minute to the last. The process's memory must not grow by more
than a tenth from the middle of the run to its end. Prints a table; ends with status 1 on a breach.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from drivers.servo import Status
from hil.recording.reader import Recording
from hil.stand.file import SIMULATED

GROWS, LOST, CHANGES = 1.1, 2e-3, 0.02  # memory; share of replies; share of a size
STAND = SIMULATED + "\n[sim.sensors]\ntorque_cell_drift = 0.0\n"
RUN = "from hil.cli.app import main; main()"


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="Hz")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "soak.h5"
        begin = time.monotonic()
        status, memory = recorded(path, 3600.0 * options.hours, options.rate)
        print(f"{options.hours:g} h at {options.rate:g} Hz in {time.monotonic() - begin:.0f} s, status {status}")
        breaches = [] if status == 0 else [f"hil record ended with status {status}"]
        breaches += checked(path, 3600.0 * options.hours, options.rate) if path.exists() else ["there is no recording"]
        middle, end = max(memory[: len(memory) // 2 + 1]), max(memory)
        print(f"memory             {middle / 1e6:.0f} MB to the middle, {end / 1e6:.0f} MB to the end")
        if end > GROWS * middle:
            breaches.append("the memory grows")
    print("no breach" if not breaches else "BREACH: " + "; ".join(breaches))
    return int(bool(breaches))


def recorded(path: Path, seconds: float, rate: float) -> tuple[int, list[int]]:
    """Record; return the exit status, and the bytes of memory in use, ten times a second while rows are written."""
    stand = path.with_name("stand.toml")
    stand.write_text(STAND)
    words = ["record", "--stand", str(stand), "--profile", "sine", "--band", "2", "--rate", str(rate)]
    words += ["--duration", str(seconds), "-o", str(path)]
    memory = [1]
    with subprocess.Popen([sys.executable, "-c", RUN, *words], stdin=subprocess.DEVNULL) as process:
        while process.poll() is None:
            time.sleep(0.1)
            if path.with_name(path.name + ".part").exists() and not list(path.parent.glob(".hil-*")):
                memory.append(resident(process.pid))
    return process.returncode, memory


def resident(pid: int) -> int:
    """Return the bytes of memory that a process uses; 0 once it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return 1024 * sum(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))


def checked(path: Path, seconds: float, rate: float) -> list[str]:
    """Print what the recording holds, and return what is wrong with it."""
    minute = round(60.0 * rate)
    with Recording(path) as recording:
        rows, lost = len(recording), 0
        for _, block in recording.rows():
            lost += int(np.count_nonzero(block["status"] & np.uint64(int(Status.NO_REPLY | Status.BAD_REPLY))))
        whole = recording.verify()
        spread = [
            np.nanstd(recording.channel("dtheta", start, start + minute))
            for start in (minute, max(0, rows - 2 * minute))
        ]
    change = abs(spread[1] / spread[0] - 1.0)
    print(f"rows               {rows}, {lost} without a reply, {'intact' if whole else 'CHANGED'}")
    print(f"file               {path.stat().st_size / rows:.1f} bytes a row")
    print(f"deflection         {spread[0]:.4f} rad rms in the second minute, {spread[1]:.4f} in the last but one")
    wrong = [] if rows == round(seconds * rate) + 1 else [f"{rows} rows"]
    wrong += [] if lost <= LOST * rows else [f"{lost} replies are missing"]
    wrong += [] if whole else ["the recording is not as it was written"]
    return wrong + ([] if change <= CHANGES else [f"the deflection changed by {change:.1%}"])


if __name__ == "__main__":
    sys.exit(main())
