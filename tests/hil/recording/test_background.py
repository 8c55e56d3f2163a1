"""A recording that another process writes: nothing that happens to one of the two costs rows or leaves a process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.errors import Untrustworthy
from hil.recording import background
from hil.recording.background import BackgroundWriter
from hil.recording.channels import Row
from hil.recording.reader import Recording
from hil.recording.ring import Ring, Shape
from hil.recording.writer import Header, RecordingWriter
from hil.recording.writer_process import drain, write

RATE = 1000.0
HALF = 4000  # rows


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
    ring = Ring.create(Shape(rows=4, row=8, events=3, event=4, rows_at=0, events_at=800))
    other = Ring(os.dup(ring.file))
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
    ring.close()
    other.close()


def test_a_recording_is_the_same_as_one_without_the_process(tmp_path: Path) -> None:
    with started(tmp_path) as writer:
        feed(writer, 3000)
        writer.event(1.0, "note", "half way")
        path = writer.finish("done")
    assert whole(path, 3000)
    with Recording(path) as recording:
        assert [event.code for event in recording.events()] == ["note"]


def test_a_run_without_rows_leaves_nothing(tmp_path: Path) -> None:
    with started(tmp_path) as writer:
        writer.discard()
    assert list(tmp_path.iterdir()) == []


def test_the_death_of_the_recorder_costs_no_row(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from hil.recording.background import BackgroundWriter\n"
        "from hil.recording.channels import Row\n"
        "from hil.recording.writer import Header, RecordingWriter\n"
        "recording = RecordingWriter(Path(sys.argv[1]), Header(profile={'kind': 'sine'}), 1000)\n"
        "writer = BackgroundWriter(recording, 1000)\n"
        "print(writer.process, flush=True)\n"
        "for seq in range(97): writer.append(Row(seq, time=seq / 1000, torque=0.01 * seq))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    words = [sys.executable, "-c", code, str(tmp_path / "a.h5")]
    run = subprocess.run(words, check=False, capture_output=True, text=True)
    assert run.returncode == -signal.SIGKILL
    assert until(lambda: not Path(f"/proc/{int(run.stdout)}").exists())
    part = tmp_path / "a.h5.part"
    assert whole(part, 97)
    with Recording(part) as recording:
        assert [(event.time, event.code) for event in recording.events()] == [(0.096, "interrupted")]


def test_the_death_of_the_writing_process_ends_the_run_and_costs_no_row(tmp_path: Path) -> None:
    with started(tmp_path) as writer:
        os.kill(pid(writer), signal.SIGKILL)
        with pytest.raises(Untrustworthy, match="was killed"):
            feed(writer, HALF, 1e-4)
        rows = len(writer)
        assert rows < HALF
        assert whole(writer.finish("killed"), rows)


@pytest.mark.study
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

    ring = Ring.create(Shape(8, 8, 2, 8, 0, 0))
    monkeypatch.setattr(threading.Thread, "start", refused)
    write(ring, -1, -1)
    assert capfd.readouterr() == ("", "")
    ring.close()
