"""Kill a recorder at random instants, alone or with the process that writes its rows, and count what the file lacks.

python benchmarks/row_loss.py --times 300 [--rates 20 100 500 1000]

Each trial is a run in real time on the simulated stand, in a process of its own. The servo notes in shared memory when
each reply has arrived, so that a lost row is one whose reply had arrived before the kill and that is not in the file;
the time lost is that since the first of them. A tick that had not begun is no row, however long ago the last one was.
`recorder`: SIGKILL to the recorder. `both`: to the writing process too, at once. Prints a line for each rate; ends with
status 1 where a trial lost more than 20 ms, or a row that was kept is not as it was read.
"""

from __future__ import annotations

import argparse
import mmap
import os
import random
import signal
import statistics
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.servo import Command, Quantity, Sample, Servo
from hil.acquisition import excitation, guard, run
from hil.recording.output import part_path
from hil.recording.reader import Recording
from hil.stand.file import SIMULATED, parse

MOST = 0.02  # s
PLACES = 1 << 14  # replies that the witness has room for
PATIENCE = 60.0  # s for a run to begin
LONGEST = 0.6  # s of a run before its kill


class Lost(NamedTuple):
    """Rows whose reply had arrived and that are not in the file; s since the first of them."""

    rows: int
    seconds: float


class Witness:
    """When each reply of a run has arrived, s on this computer's clock, in memory that outlives the run's process."""

    def __init__(self) -> None:
        self._numbers = memoryview(mmap.mmap(-1, 8 * (PLACES + 1))).cast("d")

    @property
    def count(self) -> int:
        """Replies so far, those at rest left out."""
        return int(self._numbers[0])

    def at(self, number: int) -> float:
        """Return when a reply arrived, s."""
        return self._numbers[1 + number]

    def note(self) -> None:
        """Note a reply."""
        count = int(self._numbers[0])
        self._numbers[1 + count] = time.monotonic()
        self._numbers[0] = count + 1


class Watched:
    """A servo whose replies are noted."""

    def __init__(self, servo: Servo, witness: Witness) -> None:
        self._servo, self._witness, self._armed = servo, witness, False
        self.info, self.clock = servo.info, servo.clock
        self.disarm, self.close = servo.disarm, servo.close

    def arm(self, limits: object) -> None:
        self._servo.arm(limits)  # type: ignore[arg-type]  # passed on
        self._armed = True

    def exchange(self, command: Command) -> Sample:
        sample = self._servo.exchange(command)
        if self._armed:
            self._witness.note()
        return sample


def record(path: Path, rate: float, witness: Witness, duration: float) -> None:
    """Record for `duration` s."""
    guard._LATE_RAMP = guard._LATE_OFF = 60.0  # a busy computer may make a tick late: here that ends nothing
    opened = run.open_servo

    def watched(*words: object, **settings: object) -> tuple[Servo, object]:
        servo, truth = opened(*words, **settings)  # type: ignore[arg-type]  # passed on
        return Watched(servo, witness), truth

    run.open_servo = watched  # type: ignore[assignment]  # a servo that is watched
    stand = parse(SIMULATED)
    profile = excitation.make(
        "sine",
        Quantity.TORQUE,
        amplitude=None,
        default_amplitude=0.2 * stand.checked_limits().torque,
        duration=duration,
        band=(2.0, 2.0),
        rate=rate,
        fade=0.2,
    )
    run.run(stand, profile, rate=rate, seed=0, realtime=True, output=path, guardian=False)


def begun(path: Path, rate: float) -> tuple[int, Witness]:
    """Start a run in a process of its own; return its number and witness once it has replies, or has ended."""
    witness = Witness()
    recorder = os.fork()
    if recorder == 0:
        with suppress(BaseException):
            record(path, rate, witness, duration=10.0)
        os._exit(0)
    end = time.monotonic() + PATIENCE
    while not (witness.count or is_dead(recorder)) and time.monotonic() < end:
        time.sleep(0.01)
    return recorder, witness


def children(process: int) -> list[int]:
    """Return the numbers of a process's children."""
    with suppress(OSError):
        return [int(word) for word in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
    return []


def trial(path: Path, rate: float, wait: float, *, both: bool) -> Lost | None:
    """Kill a run `wait` s after its first reply; return what was lost, None where the run never began or had ended."""
    recorder, witness = begun(path, rate)
    time.sleep(wait)
    writers = children(recorder)
    killed = time.monotonic()
    os.kill(recorder, signal.SIGKILL)
    for writer in writers if both else ():
        with suppress(ProcessLookupError):
            os.kill(writer, signal.SIGKILL)
    _, status = os.waitpid(recorder, 0)
    if not (os.WIFSIGNALED(status) and witness.count):
        return None
    while any(Path(f"/proc/{writer}/stat").exists() and not is_dead(writer) for writer in writers):
        time.sleep(2e-3)
    with Recording(part_path(path)) as recording:
        rows, sound = len(recording), recording.verify()
        sequence = recording.channel("seq")
    if not sound or not np.array_equal(sequence, np.arange(rows)):
        raise RuntimeError(f"{path}: a row is not as it was written")
    return Lost(max(0, witness.count - rows), max(0.0, killed - witness.at(rows)) if rows < witness.count else 0.0)


def is_dead(process: int) -> bool:
    """Return whether a process has ended and only its parent does not know."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def measured(rate: float, times: int, rng: random.Random, *, both: bool) -> list[Lost]:
    """Return what `times` kills at random instants lost."""
    found: list[Lost] = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(20 * times):
            lost = trial(Path(folder) / f"run{number}.h5", rate, rng.uniform(0.0, LONGEST), both=both)
            found += [] if lost is None else [lost]
            if len(found) == times:
                return found
    raise RuntimeError("the runs end by themselves")


def row(rate: float, both: bool, found: list[Lost]) -> str:
    """Return a line of the table."""
    rows, seconds = ([getattr(one, name) for one in found] for name in ("rows", "seconds"))
    cells = [
        f"{rate:g}",
        "recorder and writing process" if both else "recorder",
        str(len(found)),
        str(sum(count == 0 for count in rows)),
        f"{statistics.median(rows):g}",
        f"{max(rows)}",
        f"{statistics.median(seconds) * 1e3:.1f}",
        f"{max(seconds) * 1e3:.1f}",
        str(sum(second <= MOST for second in seconds)),
    ]
    return "| " + " | ".join(cells) + " |"


COLUMNS = (
    "Hz",
    "killed",
    "kills",
    "without a loss",
    "rows lost, median",
    "most",
    "ms lost, median",
    "worst",
    "within 20 ms",
)


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=300, help="kills of each kind, shared by the rates")
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 100.0, 500.0, 1000.0], help="Hz")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, breach = random.Random(options.seed), False  # noqa: S311 - no secret
    each = max(1, options.times // len(options.rates))
    with tempfile.TemporaryDirectory() as folder:  # compiles what is not yet, once for all
        record(Path(folder) / "first.h5", 100.0, Witness(), duration=1.0)
    print(f"load {os.getloadavg()[0]:.1f}\n\n| {' | '.join(COLUMNS)} |\n|{' --- |' * len(COLUMNS)}", flush=True)
    for both in (False, True):
        for rate in options.rates:
            found = measured(rate, each, rng, both=both)
            breach |= any(one.seconds > MOST for one in found)
            print(row(rate, both, found), flush=True)
    print("\nBREACH" if breach else "\nheld")
    return int(breach)


if __name__ == "__main__":
    sys.exit(main())
