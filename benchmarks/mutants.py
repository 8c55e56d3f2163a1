"""Change bytes of the files that hil reads, many times over: python benchmarks/mutants.py

Every mutant of a finished recording, and of one in progress, must be refused or reported as changed, or else give the
same rows, stand, profile and attributes; a recovered one gives its rows as they were, or as lost. One to eight bytes of
a table (CSV, .mat) or of a stand file change; these have no checksum, so that each must be read or refused in a
sentence. Prints a table and ends with status 1 on a breach: a change that is not noticed, an error that is not a
sentence, a crash, a hang.
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import random
import re
import resource
import signal
import string
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
from scipy.io import savemat

from hil.errors import Untrustworthy, WrongUse
from hil.exchange.importer import Column, import_table
from hil.recording.channels import CHANNELS, ROW, Row
from hil.recording.final import finalise
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter
from hil.signals.source import open_sources
from hil.stand.file import SIMULATED, load
from hil.units import factor

LIMIT = 60  # s of wall time after which a mutant counts as a hang, however busy the computer is
LONGEST, LARGEST = 5.0, 1 << 29  # s of processor time, and bytes beyond those of this process, that a mutant may take
BATCH = 200  # mutants in one process, a copy of this one, which has imported everything once
MEMORY = "/dev/shm"  # noqa: S108 - a disk would only be waited for
LONG_SENTENCE = 2000  # characters
OTHERS = re.compile(r"Traceback|\[Errno|pydantic|Input should|<list\[|\.hil-[0-9a-f]{8}|object at 0x")
GOOD = ("refused", "read", "reported as changed", "rows reported as lost", "without effect")

Content = tuple[object, ...]
Judge = Callable[[Path, Content], str]


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=10_000, help="mutants of each kind of file")
    parser.add_argument("--rows", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=math.inf, help="of wall time; then it ends with what it has")
    options = parser.parse_args()
    breaches, end = 0, time.monotonic() + 60.0 * options.minutes
    warm_up()
    with tempfile.TemporaryDirectory(dir=MEMORY if os.access(MEMORY, os.W_OK) else None) as folder:
        for number, (make, judge, most) in enumerate(FILES):
            path = make(Path(folder), options.rows)
            until = time.monotonic() + (end - time.monotonic()) / (len(FILES) - number)
            counts = Counter(outcomes(path, judge, Mutants(path, options.times, options.seed, most), until))
            print(f"{path.name}, {path.stat().st_size} bytes, {counts.total()} mutants of {most} byte(s) at most")
            for outcome, count in counts.most_common():
                print(f"  {outcome:24} {count:6}", flush=True)
                breaches += 0 if outcome in GOOD else count
    print("no breach" if not breaches else f"{breaches} BREACHES")
    return 1 if breaches else 0


def warm_up() -> None:
    """Import what the work imports, so that no copy does."""
    assert factor("torque", "mN*m") == 1e-3
    gc.freeze()


def writer(path: Path, rows: int) -> RecordingWriter:
    """Return a recording with its rows and an event."""
    header = Header(
        profile={"kind": "chirp", "mode": "torque", "amplitude": 0.006}, stand_toml=SIMULATED, truth={"Kc": 0.01}
    )
    made = RecordingWriter(path, header, rows + 50)
    for seq in range(rows):
        made.append(
            Row(seq, time=seq / 500.0, torque=0.01 * np.sin(seq / 9.0), dtheta=np.sin(seq / 9.0), temperature=30.0)
        )
    made.event(0.1, "stop-requested", "signal 2")
    made.flush()
    return made


def finished(folder: Path, rows: int) -> Path:
    """Return a finished recording."""
    return writer(folder / "finished.h5", rows).finish("done")


def cut_off(folder: Path, rows: int) -> Path:
    """Return a recording whose recorder was killed."""
    made = writer(folder / "cut_off.h5", rows)
    made.close()
    return made.path


def table(folder: Path, rows: int) -> Path:
    """Return a table in text."""
    path = folder / "table.csv"
    lines = [f"{n / 500:.4f},{math.sin(n / 9):.6f},{0.3 * math.sin(n / 9):.6f}" for n in range(rows)]
    path.write_text("\n".join(["t [s],q [mN*m],p [deg]", *lines]) + "\n")
    return path


def matlab(folder: Path, rows: int) -> Path:
    """Return a table of MATLAB."""
    path, t = folder / "table.mat", np.arange(rows) / 500.0
    savemat(path, {"t": t, "q": 1e-3 * np.sin(55 * t), "p": 0.3 * np.sin(55 * t)})
    return path


def stand(folder: Path, rows: int) -> Path:
    """Return a stand file."""
    del rows
    path = folder / "stand.toml"
    path.write_text(SIMULATED)
    return path


class Mutants:
    """Mutants of a file: `times` of them, each with 1 to `most` changed bytes; those of a text are printable."""

    def __init__(self, path: Path, times: int, seed: int, most: int) -> None:
        self.times = times
        self._data = path.read_bytes()
        self._seed, self._most = seed, most

    def __getitem__(self, number: int) -> bytes:
        generator = random.Random(f"{self._seed}, {number}")  # noqa: S311 - no secret
        data = bytearray(self._data)
        for _ in range(generator.randint(1, self._most)):
            at = generator.randrange(len(data))
            text = self._data.isascii()
            data[at] = ord(generator.choice(string.printable)) if text else data[at] ^ generator.randrange(1, 256)
        return bytes(data)


def outcomes(path: Path, judge: Judge, mutants: Mutants, until: float) -> Iterator[str]:
    """Yield the outcome of each mutant, made and judged in processes of their own, until the monotonic time `until`."""
    original: Content = ()
    if judge in {judged, recovered}:
        with Recording(path) as recording:
            original = content(recording)
    done = 0
    while done < mutants.times and time.monotonic() < until:
        batch = range(done, min(done + BATCH, mutants.times))
        lines, status = in_a_child([mutants[number] for number in batch], path, judge, original)
        yield from lines
        done += len(lines)
        if status:
            yield "hang" if status == signal.SIGALRM else f"crash (signal {status})"
            done += 1


def in_a_child(mutants: list[bytes], path: Path, judge: Judge, original: Content) -> tuple[list[str], int]:
    """Return the outcomes of the mutants up to the one that killed the process, and the signal that did (0: none)."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + LARGEST, size + LARGEST))
        for mutant in mutants:
            signal.alarm(LIMIT)
            place = path.with_name(f"mutant{path.suffixes[-1]}")
            place.write_bytes(mutant)
            began = processor_time()
            outcome = judge(place, original)
            slow = processor_time() - began > LONGEST
            os.write(writing, f"{'SLOW: ' * slow}{outcome}\n".encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        lines = pipe.read().splitlines()
    return lines, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) * -1


def processor_time() -> float:
    """Return the processor time of this process and those that it has started, s."""
    return sum(os.times()[:4])


def content(recording: Recording) -> Content:
    """Return all that a result is drawn from."""
    rows = np.concatenate([rows for _, rows in recording.rows()])
    attributes = {name: recording.attributes[name] for name in sorted(recording.attributes)}
    return rows.tobytes(), str(attributes), str(recording.profile), str(recording.truth()), str(recording.events())


def judged(path: Path, original: Content) -> str:
    """Return the outcome for a file that is identified from."""
    try:
        with open_sources([path]) as (source,):
            source.verify()
            return "without effect" if content(source.recording) == original else "NOT NOTICED"
    except Untrustworthy as error:
        return declined(error, "reported as changed")
    except WrongUse as error:
        return declined(error)
    except Exception as error:  # noqa: BLE001 - which is a breach
        return f"NO SENTENCE: {type(error).__name__}: {error}"


def recovered(path: Path, original: Content) -> str:
    """Return the outcome for a file that is recovered and then identified from."""
    place = path.with_name("recovered.h5")
    try:
        done = finalise(path, place, force=True)
        if not done.trusted:
            return "reported as changed"
        rows, damaged = original_rows(original), rows_of(place)
    except (WrongUse, Untrustworthy) as error:
        return declined(error)
    except Exception as error:  # noqa: BLE001 - which is a breach
        return f"NO SENTENCE: {type(error).__name__}: {error}".splitlines()[0]
    if len(rows) != len(damaged):
        return "NOT NOTICED: ROWS ARE GONE"
    kept = np.asarray(damaged["status"]) == 0
    if len(rows) - int(kept.sum()) != done.damaged or rows[kept].tobytes() != damaged[kept].tobytes():
        return "NOT NOTICED"
    return "rows reported as lost" if done.damaged else "without effect"


def rows_of(path: Path) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Return the rows of a recording."""
    with h5py.File(path) as file:  # just written, and so not tried out in a copy of this process
        rows = np.empty(len(file["samples/seq"]), dtype=ROW)
        for name in CHANNELS:
            rows[name] = file[f"samples/{name}"]
    return rows


def original_rows(original: Content) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Return the rows in a content."""
    data = original[0]
    assert isinstance(data, bytes)
    return np.frombuffer(data, dtype=ROW)


def imported(path: Path, original: Content) -> str:
    """Return the outcome for a table that is imported."""
    del original
    units = {"time": "s", "torque": "mN*m", "dtheta": "deg"}
    columns = {channel: Column(name, units[channel]) for channel, name in COLUMNS[path.suffix].items()}
    return in_a_sentence(lambda: import_table(path, path.with_name("imported.h5"), columns, [], force=True))


def parsed(path: Path, original: Content) -> str:
    """Return the outcome for a stand file."""
    del original
    return in_a_sentence(lambda: load(path))


def declined(error: Exception, outcome: str = "refused") -> str:
    """Return the outcome where a file is declined: in a sentence of hil's own?"""
    text = str(error)
    sound = text.strip() and not OTHERS.search(text) and len(text) < LONG_SENTENCE
    return outcome if sound else f"NO SENTENCE: {text[:200]!r}"


def in_a_sentence(work: Callable[[], object]) -> str:
    """Return whether `work` reads or refuses a file."""
    try:
        work()
    except (WrongUse, Untrustworthy) as error:
        return declined(error)
    except Exception as error:  # noqa: BLE001 - which is a breach
        return f"NO SENTENCE: {type(error).__name__}: {error}".splitlines()[0]
    return "read"


COLUMNS = {
    ".csv": {"time": "t [s]", "torque": "q [mN*m]", "dtheta": "p [deg]"},
    ".mat": {"time": "t", "torque": "q", "dtheta": "p"},
}
FILES: tuple[tuple[Callable[[Path, int], Path], Judge, int], ...] = (
    (stand, parsed, 8),
    (table, imported, 8),
    (matlab, imported, 8),
    (finished, judged, 1),
    (cut_off, recovered, 1),
)


if __name__ == "__main__":
    sys.exit(main())
