"""Cut the power at every moment of a run, on paper: replay the log of its writes to each prefix, and look what is left.

python benchmarks/power_loss.py [--seconds 2] [--rate 200] [--orders 3] [--cuts 0]
python benchmarks/power_loss.py --damage

`strace` logs what the recorder and its writing process ask of the system: writes, syncs, names. A cut after a call
leaves what was synced before it; of what was not, the replay keeps all, nothing, and `--orders` times a random part, in
sectors of 512 bytes and in any order. New names that were not synced are kept up to a random one, as a journal does. In
each state left, a finished file must be whole, and an unfinished one must give every row that had been synced, with no
row altered that it does not report. Prints a table; ends with status 1 on a breach, 2 where strace is not permitted.

--damage: instead, cut one unfinished recording off at every 512 bytes, and lose each sector and each page of it, which
then has zeros or noise. What is read, and what is recovered, must be every row that no damaged byte is in, unaltered,
with the whole header.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import astuple, dataclass, field
from pathlib import Path

import h5py
import numpy as np

from drivers.servo import Status
from hil.errors import Untrustworthy, WrongUse
from hil.recording.channels import ROW, Row, Rows
from hil.recording.final import finalise
from hil.recording.integrity import LIVE
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter
from hil.stand.file import SIMULATED

SECTOR = 512  # bytes that a disk writes whole
PAGE = 4096  # bytes that a system writes at a time
CALLS = (
    "pwrite64,write,ftruncate,fallocate,fsync,fdatasync,openat,link,linkat,rename,renameat,renameat2,unlink,unlinkat"
)
LINE = re.compile(r"^(\d+) +([\d.]+) (?:<\.\.\. (\w+) resumed>|(\w+)\()(.*)$", re.DOTALL)
FILE = re.compile(r"^\d+<((?:\\x[0-9a-f]{2})*)>")
TEXT = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')
PART, FINAL = "a.h5.part", "a.h5"
RELAXED = (  # strace makes ticks late: here that ends nothing
    "from hil.acquisition import guard; from hil.cli.app import main\nguard._LATE_RAMP = guard._LATE_OFF = 60.0; main()"
)


def plain(escaped: str) -> bytes:
    """Return the bytes of a string as strace writes it."""
    return bytes.fromhex(escaped.replace("\\x", ""))


@dataclass(slots=True)
class Call:
    """A call to the system: its name, its arguments, and its place in the log."""

    name: str
    words: str
    number: int


def calls(log: Path) -> Iterator[tuple[Call, bool, float]]:
    """Yield each call with False as it begins, with True as it returns, and the time, s; none that failed."""
    open_calls: dict[str, Call] = {}
    for number, line in enumerate(log.read_text(encoding="ascii").splitlines()):
        found = LINE.match(line)
        if found is None:
            continue
        process, at, resumed, name, words = found.groups()
        unfinished = words.endswith("<unfinished ...>")
        if resumed is None:
            call = Call(name, words, number)
            if unfinished:
                open_calls[process] = call
            elif " = -1 " in words[-80:]:
                continue
            yield call, False, float(at)
        else:
            call = open_calls.pop(process)
        if not unfinished:
            yield call, True, float(at)


@dataclass(slots=True)
class File:
    """The writes to a file in order, (offset, bytes), and how many of them are surely on the disk."""

    writes: list[tuple[int, bytes]] = field(default_factory=list)
    end: int = 0
    synced: int = 0


class Disk:
    """A folder on a disk: its files, and its names in order, of which the first ones are surely on the disk."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder).encode()
        self._names: dict[bytes, File] = {}
        self._born: dict[bytes, File] = {}  # by the first name, under which the system knows an open file for good
        self._history: list[dict[bytes, File]] = [{}]
        self._synced = 0
        self._syncing: dict[int, tuple[File | None, int]] = {}

    def apply(self, call: Call, *, returned: bool) -> bool:
        """Apply a call; return whether it concerns this folder."""
        file = FILE.match(call.words)
        path = plain(file.group(1)) if file else b""
        if call.name in {"fsync", "fdatasync"}:
            return self._sync(call, path, returned=returned)
        if returned:
            return False
        if call.name in {"pwrite64", "write", "ftruncate", "fallocate"}:
            return self._write(call, path)
        return self._rename(call)

    def _sync(self, call: Call, path: bytes, *, returned: bool) -> bool:
        kept = self._file(path)
        if path != self._folder and kept is None:
            return False
        if not returned:
            self._syncing[call.number] = (kept, len(self._history) - 1 if kept is None else len(kept.writes))
            return True
        target, count = self._syncing.pop(call.number)
        if target is None:
            self._synced = max(self._synced, count)
        else:
            target.synced = max(target.synced, count)
        return True

    def _file(self, path: bytes) -> File | None:
        return self._names.get(path) or self._born.get(path)

    def _write(self, call: Call, path: bytes) -> bool:
        target = self._file(path)
        if target is None or call.name in {"ftruncate", "fallocate"}:  # which change no byte of a file that grows
            return False
        data = TEXT.search(call.words)
        assert data is not None
        offset = int(re.findall(r"\d+", call.words[data.end() :])[1]) if call.name == "pwrite64" else target.end
        target.writes.append((offset, plain(data.group(1))))
        target.end = offset + len(target.writes[-1][1])
        return True

    def _rename(self, call: Call) -> bool:
        paths = [plain(text) for text in TEXT.findall(call.words)]
        if not paths or not all(path.rpartition(b"/")[0] == self._folder for path in paths):
            return False
        names = dict(self._names)
        if call.name == "openat":
            if "O_CREAT" not in call.words or paths[0] in names:
                return False
            names[paths[0]] = self._born[paths[0]] = File()
        elif call.name.startswith("unlink"):
            names.pop(paths[0], None)
        else:
            names[paths[1]] = names[paths[0]]
            if call.name.startswith("rename"):
                del names[paths[0]]
        self._names = names
        self._history.append(names)
        return True

    def left(self, rng: random.Random, keep: float) -> dict[str, bytes]:
        """Return the files after a cut. keep: the share of what was not synced that is on the disk all the same."""
        last = len(self._history) - 1
        chosen = {0.0: self._synced, 1.0: last}.get(keep, rng.randint(self._synced, last))
        files = {os.fsdecode(name.rpartition(b"/")[2]): file for name, file in self._history[chosen].items()}
        return {name: contents(file, rng, keep) for name, file in files.items()}

    def promised(self, rng: random.Random) -> int:
        """Return how many rows, from the first on, were synced in the unfinished recording, whatever its name."""
        named = (names.get(self._folder + b"/" + PART.encode()) for names in reversed(self._history))
        part = next((file for file in named if file is not None), None)
        return 0 if part is None else written_rows(contents(part, rng, 0.0))


def contents(file: File, rng: random.Random, keep: float) -> bytes:
    """Return the bytes of a file after a cut."""
    data = bytearray()
    for number, (offset, written) in enumerate(file.writes):
        data.extend(bytes(max(0, offset + len(written) - len(data))))
        for begin, end in sectors(offset, len(written)):
            if number < file.synced or rng.random() < keep:
                data[begin:end] = written[begin - offset : end - offset]
    return bytes(data)


def sectors(offset: int, size: int) -> Iterator[tuple[int, int]]:
    """Yield the parts of a write that a disk writes whole, from and to which byte of the file."""
    begin = offset
    while begin < offset + size:
        end = min((begin // SECTOR + 1) * SECTOR, offset + size)
        yield begin, end
        begin = end


def written_rows(data: bytes) -> int:
    """Return how many rows, from the first on, stand in the bytes of an unfinished recording."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(data)
        file.flush()
        try:
            with h5py.File(file.name) as part:
                at, length = part["live"].id.get_offset(), len(part["live"])
        except (OSError, KeyError):
            return 0
    rows = np.frombuffer(data, dtype=LIVE, count=length, offset=at)
    wrong = np.flatnonzero(rows["seq"] != np.arange(length))
    return int(wrong[0]) if len(wrong) else length


class Breach(Exception):
    """A cut that costs what must not be lost."""


def judged(files: dict[str, bytes], promised: int, truth: Rows) -> str:
    """Return what is left after a cut, in words. Raises Breach."""
    with tempfile.TemporaryDirectory() as folder:
        for name, data in files.items():
            (Path(folder) / name).write_bytes(data)
        if FINAL in files:
            with Recording(Path(folder) / FINAL) as recording:
                if not recording.verify() or rows_of(recording).tobytes() != truth.tobytes():
                    raise Breach("the finished file is not whole")
            return "the finished file"
        if PART not in files:
            if promised:
                raise Breach(f"{promised} rows were synced and have no name")
            return "nothing yet"
        try:
            with Recording(Path(folder) / PART) as recording:
                return unfinished(recording, promised, truth)
        except (WrongUse, Untrustworthy) as error:
            if promised:
                raise Breach(f"{promised} rows were synced: {error}") from error
            return "a sentence that there is no row"


def unfinished(recording: Recording, promised: int, truth: Rows) -> str:
    """Return what an unfinished recording holds, in words. Raises Breach."""
    rows = rows_of(recording)
    lost = (rows["status"] & np.uint64(int(Status.BAD_REPLY))) != 0
    if int(lost.sum()) != recording.damaged or len(rows) < promised or lost[:promised].any():
        raise Breach(f"{promised} rows were synced, {len(rows)} are there, {int(lost.sum())} of them damaged")
    if rows[~lost].tobytes() != truth[: len(rows)][~lost].tobytes():
        raise Breach("a row is altered")
    return "all synced rows, others reported as lost" if lost.any() else "all synced rows"


@dataclass(slots=True)
class Damages:
    """What one kind of damage has cost: the places tried, rows that a damaged byte was in, other rows, altered rows,
    and recordings whose rows were there and whose header was not.
    """

    places: int = 0
    rows_damaged: int = 0
    other_rows: int = 0
    altered: int = 0
    headers: int = 0

    def count(self, part: Path, truth: Rows, harmed: Rows) -> None:
        """Read and recover a damaged file, and count. harmed: for each row whether a damaged byte is in it, (n,)."""
        self.places += 1
        self.rows_damaged += int(harmed.sum())
        again = part.with_name("again.h5")
        try:
            trusted = finalise(part, again, force=True).trusted
        except (WrongUse, Untrustworthy):
            self.other_rows += int((~harmed).sum())
            return
        for path in (part, again):
            with Recording(path) as recording:
                rows, is_whole = rows_of(recording)[: len(truth)], recording.header_intact()
            kept = (rows["status"] & np.uint64(int(Status.BAD_REPLY))) == 0
            gone = np.append(~kept, np.full(len(truth) - len(rows), fill_value=True))
            self.other_rows += int((gone & ~harmed).sum())
            self.altered += sum(
                one.tobytes() != two.tobytes() for one, two in zip(rows[kept], truth[: len(rows)][kept], strict=True)
            )
            self.headers += not harmed.all() and not (is_whole and trusted)


def unfinished_part(folder: Path, count: int) -> tuple[bytes, int, Rows]:
    """Return the bytes of a recording that a kill has ended before its planned end, the place of its rows, and them."""
    rng = np.random.default_rng(0)
    profile = {"kind": "chirp", "mode": "torque", "rate": 100.0, "duration": count / 80}
    profile |= {f"setting{number}": 1.0 for number in range(12)}  # as many as a run has
    part = RecordingWriter(folder / FINAL, Header(profile, SIMULATED), count + count // 4)
    rows = np.full(count, np.array(Row(0), dtype=ROW))
    rows["seq"] = np.arange(count)
    for name in ("time", "torque", "dtheta", "command"):
        rows[name] = rng.normal(size=count)
    part.extend(rows)
    part.event(0.1, "stop-requested", "signal 2")
    place = part.place.rows_at
    part.close()
    return part.path.read_bytes(), place, rows


def damaged(data: bytes, step: int) -> Iterator[tuple[str, int, int, bytes]]:
    """Yield each damaged file of a kind, in every `step`-th place: kind, first and last damaged byte, its bytes."""
    rng = random.Random(0)  # noqa: S311 - no secret
    for begin in range(SECTOR, len(data), SECTOR * step):
        yield "cut off", begin, len(data), data[:begin]
    for size in (SECTOR, PAGE):
        for begin in range(0, len(data), size * step):
            end = min(begin + size, len(data))
            yield f"zeros in {size} bytes", begin, end, data[:begin] + bytes(end - begin) + data[end:]
            yield f"noise in {size} bytes", begin, end, data[:begin] + rng.randbytes(end - begin) + data[end:]


def damages(folder: Path, count: int, step: int) -> dict[str, Damages]:
    """Return what each kind of damage costs an unfinished recording of `count` rows, in every `step`-th place."""
    data, place, truth = unfinished_part(folder, count)
    begins = place + LIVE.itemsize * np.arange(count)
    found: dict[str, Damages] = {}
    for kind, first, end, bytes_left in damaged(data, step):
        part = folder / "b.h5.part"
        part.write_bytes(bytes_left)
        harmed = (begins < end) & (begins + LIVE.itemsize > first)
        found.setdefault(kind, Damages()).count(part, truth, harmed)
    return found


def print_damages() -> int:
    """Print what each kind of damage costs as rows of a table, and return the exit status."""
    with tempfile.TemporaryDirectory() as name:
        found = damages(Path(name), 200, 1)
    print("damage,places,rows with a damaged byte,other rows lost,rows altered,headers lost")
    for kind, one in found.items():
        print(",".join(map(str, (kind, *astuple(one)))))
    return int(any(one.other_rows or one.altered or one.headers for one in found.values()))


def rows_of(recording: Recording) -> Rows:
    """Return all rows of a recording."""
    return np.concatenate([np.empty(0, dtype=ROW), *(rows for _, rows in recording.rows())])


def traced(folder: Path, log: Path, seconds: float, rate: float) -> bool:
    """Record under strace; return whether that is permitted."""
    words = ["record", "--backend", "sim", "--realtime", "--profile", "sine", "--band", "2", "--no-guardian"]
    words += ["--fade", "0.1", "--rate", str(rate), "--duration", str(seconds), "-o", str(folder / FINAL)]
    if shutil.which("strace") is None:
        return False
    trace = ["strace", "-f", "-y", "-xx", "-s", "100000000", "-ttt", "-e", f"trace={CALLS}", "-o", str(log)]
    subprocess.run([*trace, sys.executable, "-c", RELAXED, *words], check=False, capture_output=True)
    return (folder / FINAL).exists()  # whose ticks may have come too late to be trusted


def delays(log: Path) -> float:
    """Return the longest s for which a row was with the system and not surely on the disk."""
    worst = 0.0
    waiting: list[float] = []
    covered: dict[int, int] = {}
    for call, returned, at in calls(log):
        file = FILE.match(call.words)
        if file is None or not plain(file.group(1)).endswith(b".part"):
            continue
        if call.name == "fsync" and not returned:
            covered[call.number] = len(waiting)
        elif call.name == "fsync":
            gone = covered.pop(call.number)
            worst = max([worst, *(at - one for one in waiting[:gone])])
            covered = {number: max(0, count - gone) for number, count in covered.items()}
            del waiting[:gone]
        elif call.name == "pwrite64" and not returned:
            waiting.append(at)
    return worst


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=2.0, help="of the run")
    parser.add_argument("--rate", type=float, default=200.0, help="Hz")
    parser.add_argument("--orders", type=int, default=3, help="random parts of what was not synced, at each cut")
    parser.add_argument("--cuts", type=int, default=0, help="cuts that are tried, at random (0: all)")
    parser.add_argument("--damage", action="store_true", help="damage an unfinished recording instead")
    options = parser.parse_args()
    if options.damage:
        return print_damages()
    rng = random.Random(0)  # noqa: S311 - no secret
    with tempfile.TemporaryDirectory() as name:
        folder, log = Path(name) / "run", Path(name) / "log"
        folder.mkdir()
        if not traced(folder, log, options.seconds, options.rate):
            print("strace is not here, or not permitted: not measured")
            return 2
        with Recording(folder / FINAL) as recording:
            truth = rows_of(recording)
        found, breaches, cuts = replayed(log, folder, truth, options, rng)
        risk = delays(log)
    print(f"{len(truth)} rows, {cuts} cuts, {sum(found.values())} states of the disk; load {os.getloadavg()[0]:.1f}")
    for left, count in sorted(found.items()):
        print(f"| {left} | {count} |")
    print(f"a row was not synced for {risk:.2f} s at most")
    print("no breach" if not breaches else "BREACH: " + "; ".join(breaches[:10]))
    return int(bool(breaches))


def cut_points(log: Path, folder: Path) -> Iterator[tuple[Disk, Call]]:
    """Yield the disk after each call that concerns it, and the call."""
    disk = Disk(folder)
    for call, returned, _ in calls(log):
        if disk.apply(call, returned=returned):
            yield disk, call


def replayed(
    log: Path, folder: Path, truth: Rows, options: argparse.Namespace, rng: random.Random
) -> tuple[Counter[str], list[str], int]:
    """Return how often what was left, the breaches, and the number of cuts."""
    concerned = sum(1 for _ in cut_points(log, folder))
    chosen = set(rng.sample(range(concerned), min(options.cuts or concerned, concerned)))
    found: Counter[str] = Counter()
    breaches: list[str] = []
    for number, (disk, call) in enumerate(cut_points(log, folder)):
        if number not in chosen:
            continue
        promised = disk.promised(rng)
        for keep in (0.0, 1.0, *(rng.random() for _ in range(options.orders))):
            try:
                found[judged(disk.left(rng, keep), promised, truth)] += 1
            except Breach as breach:
                breaches.append(f"cut {number} after {call.name}: {breach}")
    return found, breaches, len(chosen)


if __name__ == "__main__":
    sys.exit(main())
