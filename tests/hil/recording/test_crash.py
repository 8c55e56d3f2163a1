"""What a kill, a removed folder or another recorder leaves on disk: no dead end, no stranger's rows, none lost."""

from __future__ import annotations

import importlib
import math
import os
import shutil
import signal
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hil.cli import app as cli
from hil.errors import Untrustworthy, WrongUse
from hil.recording import output
from hil.recording import writer as writer_module
from hil.recording.channels import ROW, Row
from hil.recording.final import finalise
from hil.recording.integrity import EVENT, LIVE
from hil.recording.output import atomic_write, check_unfinished, remove_unfinished
from hil.recording.reader import EVENTS, Recording
from hil.recording.writer import Header, RecordingWriter
from hil.signals.inspection import inspect
from hil.signals.source import open_sources
from hil.stand.file import SIMULATED

from ..conftest import copied, exit_status

HEADER = Header(profile={"kind": "chirp"})


def recorded(path: Path, rows: int) -> RecordingWriter:
    part = RecordingWriter(path, HEADER, rows + 5)
    for seq in range(rows):
        part.append(Row(seq, time=seq / 100.0, torque=0.5))
    part.flush()
    return part


def begin(path: Path) -> None:
    RecordingWriter(path, HEADER, 5)


def killing(monkeypatch: pytest.MonkeyPatch, at: int, *, after: bool) -> None:
    """Let the `at`-th of the calls that touch the disk kill the process, before it acts or after it has."""
    calls = count(1)

    def fatal(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*words: Any, **settings: Any) -> Any:
            due = next(calls) == at
            if due and not after:
                os.kill(os.getpid(), signal.SIGKILL)
            answer = function(*words, **settings)
            if due:
                os.kill(os.getpid(), signal.SIGKILL)
            return answer

        return call

    for name in ("open", "fsync", "link", "unlink", "close"):
        monkeypatch.setattr(os, name, fatal(getattr(os, name)))
    for name in ("write_at", "_write_header", "sign", "_reserve_contiguous"):
        monkeypatch.setattr(writer_module, name, fatal(getattr(writer_module, name)))


@pytest.mark.parametrize(
    ("after", "step"), [(False, 2), *(pytest.param(after, 1, marks=pytest.mark.study) for after in (False, True))]
)
def test_a_kill_at_any_call_of_the_start_leaves_a_whole_part_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: int, *, after: bool
) -> None:
    monkeypatch.setattr(writer_module, "_software", dict)
    seen = set()
    for at in count(1, step):
        folder = tmp_path / str(at)
        folder.mkdir()
        with monkeypatch.context() as patch:
            killing(patch, at, after=after)
            killed = exit_status(copied(partial(begin, folder / "a.h5"))) == -signal.SIGKILL
        if not killed:
            break
        part = folder / "a.h5.part"
        seen.add(part.exists())
        if part.exists():
            assert finalise(part, folder / "b.h5")[:3] == (0, 0, True)
            part.unlink()
        recorded(folder / "a.h5", 3).finish("done")
        assert {item.name for item in folder.iterdir()} <= {"a.h5", "b.h5"}
    assert seen == {False, True}


def test_the_temporary_files_of_dead_processes_are_removed_and_those_of_living_ones_are_not(tmp_path: Path) -> None:
    dead, other = tmp_path / f".hil-{'0' * 32}.csv", tmp_path / ".hil-notes"
    dead.write_text("half a table")
    other.write_text("somebody's")
    (tmp_path / f".hil-{'1' * 32}").symlink_to(other)
    with atomic_write(tmp_path / "a.csv", force=False) as living, atomic_write(tmp_path / "b.csv", force=False) as new:
        assert not dead.exists()
        living.write_text("1")
        new.write_text("2")
    assert (tmp_path / "a.csv").read_text() + (tmp_path / "b.csv").read_text() == "12"
    assert other.read_text() == "somebody's"


def test_nothing_is_removed_on_a_filesystem_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(file: int, *, shared: bool) -> None:
        del file, shared
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(output, "lock", refuse)
    (tmp_path / f".hil-{'0' * 32}.h5").write_text("perhaps in use")
    recorded(tmp_path / "a.h5", 3).finish("done")
    assert {item.name for item in tmp_path.iterdir()} == {"a.h5", f".hil-{'0' * 32}.h5"}


def test_a_live_part_is_not_recovered(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    part = recorded(tmp_path / "a.h5", 3)
    assert cli.run(["recover", str(part.path)]) == 2
    assert "is being recorded or read at this moment" in capfd.readouterr().err
    with pytest.raises(WrongUse, match="is being recorded"):
        check_unfinished(tmp_path / "a.h5")
    part.close()
    with pytest.raises(WrongUse, match="hil recover"):
        check_unfinished(tmp_path / "a.h5")
    assert cli.run(["recover", str(part.path)]) == 0


def test_a_part_of_an_older_version_that_was_cut_off_is_no_dead_end(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.h5.part").write_bytes(b"\x89HDF")
    assert cli.run(["recover", str(tmp_path / "a.h5.part")]) == 2
    assert "it has no row that can be read: remove it, or choose another name" in capfd.readouterr().err


@pytest.mark.parametrize("content", [b"", b"\x89HDF", b"a film", "a finished recording"])
def test_a_part_that_hil_did_not_begin_is_never_removed(
    tmp_path: Path, content: bytes | str, capfd: pytest.CaptureFixture[str]
) -> None:
    """A browser's download of run1.h5 has the name of a recording in progress."""
    part = tmp_path / "a.h5.part"
    if isinstance(content, str):
        recorded(tmp_path / "b.h5", 3).finish("done")
        content = (tmp_path / "b.h5").read_bytes()
    part.write_bytes(content)
    status = cli.run(["record", "--backend", "sim", "--duration", "1", "-o", str(tmp_path / "a.h5"), "--force"])
    assert (status, part.read_bytes()) == (2, content)
    assert "no recording that hil began" in capfd.readouterr().err
    with pytest.raises(WrongUse, match="Choose another name"):
        remove_unfinished(tmp_path / "a.h5")


def test_rows_that_an_older_version_reserved_and_did_not_mark_are_no_rows(tmp_path: Path) -> None:
    part = recorded(tmp_path / "a.h5", 0)
    part.close()
    with h5py.File(part.path, "r+") as file:
        del file["live"]
        file["live"] = np.zeros(5, dtype=ROW)
    with Recording(part.path) as recording:
        assert len(recording) == 0


def test_a_part_that_is_cut_off_or_loses_a_page_keeps_every_row_that_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A short form of benchmarks/power_loss.py --damage, without the copies of the process that read a header first."""
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    monkeypatch.setattr(Recording, "_try_out", lambda _: None)
    found = importlib.import_module("power_loss").damages(tmp_path, 40, 97)
    assert min(one.places for one in found.values()) > 0
    assert {(one.other_rows, one.altered, one.headers) for one in found.values()} == {(0, 0, 0)}


def test_what_a_cut_has_cost_is_said_and_the_rest_is_used(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    part = recorded(tmp_path / "a.h5", 30)
    place = part.place.rows_at
    part.close()
    part.path.write_bytes(part.path.read_bytes()[: place + 20 * LIVE.itemsize])
    assert cli.run(["recover", str(part.path)]) == 0
    said = capfd.readouterr()
    assert "20 samples recovered" in said.out
    assert "the file is damaged after row 20: later rows, if there were any, are missing" in said.err
    assert cli.run(["inspect", "--verify", str(part.path)]) == 1
    with open_sources([part.path]) as (source,):
        source.verify()


def test_a_finished_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.h5", 3000).finish("done")
    path.write_bytes(path.read_bytes()[:-512])
    with pytest.raises(WrongUse, match="is cut off"):
        Recording(path)


def test_a_header_of_any_size_stands_before_the_rows_and_again_behind_the_events(tmp_path: Path) -> None:
    many = {f"setting{number}": 1.0 for number in range(20)}  # HDF5 keeps more than eight in another way
    for size in (0, 3_000, 40_000, 300_000):
        header = Header(profile={"setpoints": "1" * size, **many}, stand_toml="x" * size, truth={"Kc": 1.0})
        part = RecordingWriter(tmp_path / f"{size}.h5", header, 7)
        place = part.place
        part.close()
        data = part.path.read_bytes()
        assert place.events_at == place.rows_at + 7 * LIVE.itemsize
        second = data[place.events_at + EVENTS * EVENT.itemsize :]
        assert second[: place.rows_at] == data[: place.rows_at]
        assert int.from_bytes(data[28:36], "little") == len(data) - len(second)


def test_every_number_of_rows_is_read_and_recovered(tmp_path: Path) -> None:
    part = RecordingWriter(tmp_path / "a.h5", HEADER, 20, batch=1)
    for rows in range(21):
        with Recording(part.path) as recording:
            assert (len(recording), recording.damaged, recording.verify()) == (rows, 0, True)
        if rows % 10 == 0:
            assert finalise(part.path, tmp_path / "b.h5", force=True)[:3] == (rows, 0, True)
        if rows < 20:
            part.append(Row(rows, time=rows / 100.0, torque=0.5))
    part.close()


@pytest.mark.study
def test_a_recording_of_few_rows_is_looked_at_or_refused_in_a_sentence(tmp_path: Path) -> None:
    header = Header(profile={"kind": "sine", "mode": "torque", "rate": 500.0}, stand_toml=SIMULATED)
    part = RecordingWriter(tmp_path / "a.h5", header, 70, batch=1)
    seen = []
    for seq in range(66):
        if seq in {0, 1, 15, 16, 17, 40, 63}:
            with suppress(Untrustworthy):
                seen.append(inspect(part.path).samples)
        t, swing = seq / 500.0, math.sin(seq / 9.0)
        part.append(Row(seq, time=t, read_time=t, torque=0.006 * swing, dtheta=0.3 * swing, temperature=30.0))
    part.close()
    assert seen == [16, 17, 40, 63]


# --- a name that is lost ---------------------------------------------------------------------------------------------


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, beside the folder `run` of the recordings."""
    (tmp_path / "run").mkdir()
    (tmp_path / "cwd").mkdir()
    monkeypatch.chdir(tmp_path / "cwd")
    return tmp_path / "cwd"


def remove_folder(part: RecordingWriter) -> None:
    shutil.rmtree(part.path.parent)


def remove(part: RecordingWriter) -> None:
    part.path.unlink()


def replace(part: RecordingWriter) -> None:
    part.path.unlink()
    part.path.write_text("somebody else's")


@pytest.mark.parametrize(
    ("lose", "place"), [(remove_folder, "cwd/a.h5"), (remove, "run/a.h5"), (replace, "run/a.h5")], ids=lambda one: one
)
def test_a_recording_that_lost_its_name_is_finished_all_the_same(
    tmp_path: Path, elsewhere: Path, lose: Callable[[RecordingWriter], None], place: str
) -> None:
    (elsewhere / "unrelated").touch()
    with recorded(tmp_path / "run" / "a.h5", 12) as part:
        lose(part)
        part.append(Row(12))
        path = part.finish("done")
        assert path == part.final
        assert path.samefile(tmp_path / place)
        assert str(path) in part.moved
    with Recording(path) as recording:
        assert (len(recording), recording.verify()) == (13, True)
    if lose is replace:
        assert (tmp_path / "run" / "a.h5.part").read_text() == "somebody else's"
    assert not [item for item in tmp_path.rglob("*.part") if lose is not replace]


def test_a_rescued_recording_replaces_nothing(tmp_path: Path, elsewhere: Path) -> None:
    for name in ("a.h5", "a-rescued.h5.part"):
        (elsewhere / name).write_text("somebody's")
    with recorded(tmp_path / "run" / "a.h5", 12) as part:
        remove_folder(part)
        assert part.finish("done", force=True) == elsewhere / "a-rescued2.h5"
    assert [(elsewhere / name).read_text() for name in ("a.h5", "a-rescued.h5.part")] == ["somebody's"] * 2


def test_where_no_place_takes_the_rows_the_message_names_no_file_that_is_not_there(
    tmp_path: Path, elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "none"))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "none"))
    with recorded(tmp_path / "run" / "a.h5", 12) as part:
        remove_folder(part)
        elsewhere.rmdir()
        with pytest.raises(WrongUse, match="could not be copied"):
            part.finish("done")
