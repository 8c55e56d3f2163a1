"""Which process records: only a process of hil that a recording itself names is ever sent a signal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.recording.channels import Row
from hil.recording.writer import Header, RecordingWriter
from hil.studio import growing
from hil.studio.folder import Folder
from hil.studio.growing import interrupt, recorder_of
from hil.studio.jobs import Jobs

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc: no run is found at all")


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[RecordingWriter]:
    """A recording in progress of this process."""
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"kind": "sine", "duration": 1.0}), 9) as writer:
        writer.append(Row(0))
        yield writer


@pytest.fixture
def signals() -> Iterator[list[int]]:
    """The signals SIGUSR1 that this process gets."""
    got: list[int] = []
    before = signal.signal(signal.SIGUSR1, lambda number, _: got.append(number))
    yield got
    signal.signal(signal.SIGUSR1, before)


def test_the_recorder_of_a_recording_is_the_process_that_it_names(
    recording: RecordingWriter, signals: list[int]
) -> None:
    named = recorder_of(recording.path)
    assert named is not None
    assert named.process == os.getpid()
    interrupt(named, recording.path, signal.SIGUSR1)
    assert signals == [signal.SIGUSR1]
    recording.close()
    interrupt(named, recording.path, signal.SIGUSR1)
    assert (recorder_of(recording.path), signals) == (None, [signal.SIGUSR1])


def test_a_process_that_got_the_number_of_a_dead_recorder_is_not_signalled(
    recording: RecordingWriter, signals: list[int]
) -> None:
    named = recorder_of(recording.path)
    assert named is not None
    interrupt(named._replace(mark=named.mark[:-1]), recording.path, signal.SIGUSR1)
    assert signals == []


def test_where_the_system_does_not_tell_when_a_process_started_no_run_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("hil.recording.integrity", "hil.studio.growing"):
        monkeypatch.setattr(f"{module}.process_mark", lambda _: "")
    with RecordingWriter(tmp_path / "a.h5", Header(profile={}), 9) as writer:
        assert recorder_of(writer.path) is None


@pytest.mark.parametrize("content", ["nothing", "a download", "a copy of a recording"])
def test_a_part_of_another_program_is_no_run(recording: RecordingWriter, content: str) -> None:
    part = recording.path.with_name("film.mp4.part")
    data = {"nothing": b"", "a download": os.urandom(9000)}.get(content, recording.path.read_bytes())
    code = "import sys; file = open(sys.argv[1], 'r+b'); print(flush=True); sys.stdin.read()"
    part.write_bytes(data)
    words = [sys.executable, "-c", code, str(part)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"\n"
        recording.close()
        jobs = Jobs(Folder(part.parent))
        jobs.find_foreign()
        jobs.stop()
        assert (jobs.running, other.poll()) == (None, None)
        other.communicate()


def test_a_pipe_or_a_folder_is_no_run_and_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.part")
    (tmp_path / "b.part").mkdir()
    assert [growing.recorder_of(tmp_path / name) for name in ("a.part", "b.part", "none.part")] == [None] * 3
