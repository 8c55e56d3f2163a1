"""A recording that another process writes: nothing that happens to one of the two costs rows or leaves a process."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from hil.errors import Untrustworthy
from hil.recording import background
from hil.recording import ring as ring_module
from hil.recording.background import BackgroundWriter, complete
from hil.recording.channels import Row
from hil.recording.reader import Recording
from hil.recording.ring import Ring, Shape
from hil.recording.writer import Header, RecordingWriter
from hil.recording.writer_process import drain, write

RATE = 1000.0
HALF = 4000  # rows
FOLDERS = ring_module._folders  # those of a user


@pytest.fixture(autouse=True)
def memory(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the shared memory of this test."""
    folder = tmp_path_factory.mktemp("memory")
    monkeypatch.setattr(ring_module, "_folders", lambda: [str(folder)])
    return folder


def started(folder: Path, planned: int = 20_000) -> BackgroundWriter:
    return BackgroundWriter(RecordingWriter(folder / "a.h5", Header(profile={"kind": "sine"}), planned), RATE)


def row(seq: int) -> Row:
    return Row(seq, time=seq / RATE, torque=0.01 * seq)


def feed(writer: BackgroundWriter, rows: int, pause: float = 0.0) -> None:
    for seq in range(rows):
        writer.append(row(seq))
        time.sleep(pause)


def pid(writer: BackgroundWriter) -> int:
    """The writing process: the only child of this one."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    assert len(children) == 1
    assert len(writer) >= 0
    return int(children[0])


def whole(path: Path, rows: int) -> bool:
    with Recording(path) as recording:
        return recording.verify() and recording.channel("torque").tolist() == [0.01 * seq for seq in range(rows)]


def until(condition: Callable[[], bool]) -> bool:
    for _ in range(2000):
        if condition():
            return True
        time.sleep(5e-3)
    return False


def test_a_ring_gives_back_what_was_put_in_order_and_says_how_much_is_waiting(tmp_path: Path) -> None:
    ring = Ring.create(Shape(rows=4, row=8, events=3, event=4, rows_at=0, events_at=800), str(uuid.uuid4()))
    other = Ring(os.dup(ring.file), ring.path)
    with (tmp_path / "file").open("w+b") as file:
        for number in range(10):
            assert ring.add(number.to_bytes(8, "little")) == 1 + number % 3
            if number % 3 == 2:
                drain(other, file.fileno())
        for word in (b"aaaa", b"bbbb", b"cccc"):  # the last place is kept
            ring.add_event(word)
        drain(other, file.fileno())
        assert file.read(80) == b"".join(number.to_bytes(8, "little") for number in range(10))
        file.seek(800)
        assert file.read() == b"aaaabbbb"
    for number in range(6):
        assert ring.add(bytes(8)) == min(number, 4) + 1
    assert (ring.put, other.taken) == (14, 10)
    ring.remove()
    ring.close()
    other.close()


def test_a_recording_is_the_same_as_one_without_the_process(tmp_path: Path) -> None:
    with started(tmp_path) as writer:
        feed(writer, 3000)
        writer.event(1.0, "note", "half way")
        writer.flush()
        with Recording(writer.path) as recording:
            assert len(recording) == 3000
        path = writer.finish("done")
    assert whole(path, 3000)
    with Recording(path) as recording:
        assert [event.code for event in recording.events()] == ["note"]


def test_a_run_without_rows_leaves_nothing(tmp_path: Path) -> None:
    with started(tmp_path) as writer:
        writer.discard()
    assert list(tmp_path.iterdir()) == []


def killed(folder: Path, memory: Path, rate: float, *, both: bool) -> Path:
    """The `.part` of a run of 97 rows whose recorder was killed, and at once or before it its writing process."""
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from hil.recording import ring; ring._folders = lambda: [sys.argv[2]]\n"
        "from hil.recording.background import BackgroundWriter\n"
        "from hil.recording.channels import Row\n"
        "from hil.recording.writer import Header, RecordingWriter\n"
        "recording = RecordingWriter(Path(sys.argv[1]), Header(profile={'kind': 'sine'}), 1000)\n"
        f"writer = BackgroundWriter(recording, {rate})\n"
        "print(writer.process, flush=True)\n"
        f"if {both}: os.kill(writer.process, signal.SIGSTOP)\n"
        "for seq in range(97): writer.append(Row(seq, time=seq / 1000, torque=0.01 * seq))\n"
        f"if {both}: os.kill(writer.process, signal.SIGKILL)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    words = [sys.executable, "-c", code, str(folder / "a.h5"), str(memory)]
    run = subprocess.run(words, check=False, capture_output=True, text=True)
    assert run.returncode == -signal.SIGKILL
    assert until(lambda: not Path(f"/proc/{int(run.stdout)}").exists())
    return folder / "a.h5.part"


@pytest.mark.parametrize(("rate", "both"), [(1000, False), (20, True)])
def test_the_death_of_the_recorder_or_of_both_costs_no_row(
    tmp_path: Path, memory: Path, rate: float, *, both: bool
) -> None:
    part = killed(tmp_path, memory, rate, both=both)
    assert len(list(memory.iterdir())) == both
    for _ in range(2):
        complete(part)
        assert whole(part, 97)
        assert list(memory.iterdir()) == []
    with Recording(part) as recording:
        assert [(event.time, event.code) for event in recording.events()] == [(0.096, "interrupted")]


def test_rows_in_memory_are_left_alone_while_a_process_has_them_or_where_the_file_is_another(
    tmp_path: Path, memory: Path
) -> None:
    with started(tmp_path) as writer:
        feed(writer, 100)
        copy = Path(shutil.copy(writer.path, tmp_path / "copy.h5.part"))
        complete(copy)
        assert len(list(memory.iterdir())) == 1
        assert whole(writer.finish("done"), 100)
    assert list(memory.iterdir()) == []
    uid = str(uuid.uuid4())
    Ring.create(Shape(rows=4, row=8, events=3, event=4, rows_at=0, events_at=800), uid).close()
    with h5py.File(copy, "r+") as file:
        file.attrs["uid"] = uid
    before = copy.read_bytes()
    complete(copy)
    assert len(list(memory.iterdir())) == 1
    assert copy.read_bytes() == before
    for uid in ("../../etc/passwd", "", "\x00"):
        assert Ring.left(uid) is None


def test_rows_in_memory_that_nobody_recovers_are_removed_after_a_week_unless_a_process_has_them(memory: Path) -> None:
    shape = Shape(rows=4, row=8, events=3, event=4, rows_at=0, events_at=800)
    new, old, used = (Ring.create(shape, str(uuid.uuid4())) for _ in range(3))
    new.close()
    old.close()
    for ring in (old, used):
        os.utime(ring.path, (0, time.time() - 8 * 86400))
    latest = Ring.create(shape, str(uuid.uuid4()))
    assert {path.name for path in memory.iterdir()} == {ring.path.name for ring in (new, used, latest)}
    used.close()
    latest.close()


def test_the_death_of_the_writing_process_ends_the_run_and_costs_no_row(tmp_path: Path) -> None:
    with started(tmp_path) as writer:
        os.kill(pid(writer), signal.SIGKILL)
        with pytest.raises(Untrustworthy, match="was killed"):
            feed(writer, HALF, 1e-4)
        rows = len(writer)
        assert rows < HALF
        assert whole(writer.finish("killed"), rows)


def test_a_disk_that_hangs_ends_the_run_when_the_memory_is_half_full_and_costs_no_row(tmp_path: Path) -> None:
    with started(tmp_path) as writer:
        os.kill(pid(writer), signal.SIGSTOP)
        with pytest.raises(Untrustworthy, match="the disk has not answered"):
            feed(writer, 3 * HALF)
        assert HALF <= len(writer) <= HALF + 100
        assert whole(writer.finish("hung"), len(writer))  # the stopped process is woken up


def test_a_disk_that_does_not_answer_at_the_end_is_left_to_the_writing_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(background, "_PATIENCE", 0.1)
    monkeypatch.setattr(signal, "SIGCONT", signal.SIGURG)  # as one that waits for a disk is not woken up
    writer = started(tmp_path)
    writing = pid(writer)
    os.kill(writing, signal.SIGSTOP)
    feed(writer, 100)
    with pytest.raises(Untrustworthy, match=rf"100 of 100 rows are in the memory of process {writing}"):
        writer.finish("done")
    writer.close()
    os.kill(writing, 18)  # SIGCONT, under its number: the disk answers again
    os.waitpid(writing, 0)
    assert whole(tmp_path / "a.h5.part", 100)


def test_a_disk_that_fails_is_reported_in_a_sentence(tmp_path: Path) -> None:
    recording = RecordingWriter(tmp_path / "a.h5", Header(profile={"kind": "sine"}), 5000)
    read_only = os.open(recording.path, os.O_RDONLY)
    os.dup2(read_only, recording.place.file)
    os.close(read_only)
    writer = BackgroundWriter(recording, RATE)
    with pytest.raises(Untrustworthy, match=r"cannot be written any further \(Bad file descriptor\)"):
        feed(writer, HALF, 1e-4)
    with pytest.raises(Untrustworthy, match="cannot be written any further"):
        writer.close()


def test_a_process_that_gets_no_thread_to_make_rows_durable_is_not_ready(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def refused(_thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    ring = Ring.create(Shape(8, 8, 2, 8, 0, 0), str(uuid.uuid4()))
    monkeypatch.setattr(threading.Thread, "start", refused)
    write(ring, -1, -1)
    assert capfd.readouterr() == ("", "")
    ring.remove()
    ring.close()


def test_a_computer_whose_folders_for_temporary_files_cannot_be_written_has_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr("tempfile.gettempdir", none)
    assert FOLDERS() == [ring_module._SHARED]
