"""Change one byte of a recording, many times over, and see whether it is noticed: python benchmarks/mutants.py

Every mutant of a finished recording, and of one in progress, must be refused or reported as changed, or else give the
same rows, stand, profile and attributes; a recovered one gives its rows as they were, or as lost. Prints a table and
ends with status 1 on a breach: a change that is not noticed, an error that is not a sentence, a crash, a hang.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from hil.errors import Untrustworthy, WrongUse
from hil.recording.channels import Row
from hil.recording.final import finalise
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter
from hil.signals.source import open_sources
from hil.stand.file import SIMULATED

LIMIT = 20  # s that a mutant may take on a busy computer; opening one has 2 s of processor time
BATCH = 200  # mutants in one process
GOOD = ("refused", "reported as changed", "rows reported as lost", "without effect")

Content = tuple[object, ...]


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=10_000, help="mutants of each kind of file")
    parser.add_argument("--rows", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    breaches = 0
    with tempfile.TemporaryDirectory() as folder:
        for path, judge in (
            (finished(Path(folder), options.rows), judged),
            (cut_off(Path(folder), options.rows), recovered),
        ):
            counts = Counter(outcomes(path, judge, options.times, options.seed))
            print(f"{path.name}, {path.stat().st_size} bytes, {options.times} mutants of one byte")
            for outcome, count in counts.most_common():
                print(f"  {outcome:24} {count:6}")
                breaches += 0 if outcome in GOOD else count
    print("no breach" if not breaches else f"{breaches} BREACHES")
    return 1 if breaches else 0


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


def outcomes(path: Path, judge: Callable[[Path, Content], str], times: int, seed: int) -> Iterator[str]:
    """Yield the outcome of each mutant, made and judged in processes of their own."""
    data, original = path.read_bytes(), content(path)
    generator = random.Random(seed)  # noqa: S311 - no secret
    mutants = [(generator.randrange(len(data)), generator.randrange(1, 256)) for _ in range(times)]
    done = 0
    while done < times:
        lines, status = in_a_child(mutants[done : done + BATCH], data, path, judge, original)
        yield from lines
        done += len(lines)
        if status:
            yield "hang" if status == signal.SIGALRM else f"crash (signal {status})"
            done += 1


def in_a_child(
    mutants: list[tuple[int, int]], data: bytes, path: Path, judge: Callable[[Path, Content], str], original: Content
) -> tuple[list[str], int]:
    """Return the outcomes of the mutants up to the one that killed the process, and the signal that did (0: none)."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        for at, change in mutants:
            signal.alarm(LIMIT)
            mutant = bytearray(data)
            mutant[at] ^= change
            place = path.with_name(f"mutant{path.suffixes[-1]}")
            place.write_bytes(mutant)
            os.write(writing, f"{judge(place, original)}\n".encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        lines = pipe.read().splitlines()
    return lines, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) * -1


def content(path: Path) -> Content:
    """Return all that a result is drawn from."""
    with Recording(path) as recording:
        rows = np.concatenate([rows for _, rows in recording.rows()])
        attributes = {name: recording.attributes[name] for name in sorted(recording.attributes)}
        return rows.tobytes(), str(attributes), str(recording.profile), str(recording.truth()), str(recording.events())


def judged(path: Path, original: Content) -> str:
    """Return the outcome for a file that is identified from."""
    try:
        with open_sources([path]) as (source,):
            source.verify()
        return "without effect" if content(path) == original else "NOT NOTICED"
    except Untrustworthy:
        return "reported as changed"
    except WrongUse:
        return "refused"
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
    except (WrongUse, Untrustworthy):
        return "refused"
    except Exception as error:  # noqa: BLE001 - which is a breach
        return f"NO SENTENCE: {type(error).__name__}: {error}"
    if len(rows) != len(damaged):
        return "NOT NOTICED: ROWS ARE GONE"
    kept = np.asarray(damaged["status"]) == 0
    if len(rows) - int(kept.sum()) != done.damaged or rows[kept].tobytes() != damaged[kept].tobytes():
        return "NOT NOTICED"
    return "rows reported as lost" if done.damaged else "without effect"


def rows_of(path: Path) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Return the rows of a recording."""
    with Recording(path) as recording:
        return np.concatenate([rows for _, rows in recording.rows()])


def original_rows(original: Content) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Return the rows in a content."""
    from hil.recording.channels import ROW

    data = original[0]
    assert isinstance(data, bytes)
    return np.frombuffer(data, dtype=ROW)


if __name__ == "__main__":
    sys.exit(main())
