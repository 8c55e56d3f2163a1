"""Writing a result: whole or not at all, never over anything but an ordinary file, never through a link."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.recording import output, posix
from hil.recording.channels import Row
from hil.recording.final import finalise
from hil.recording.output import atomic_write, check_ended
from hil.recording.writer import Header, RecordingWriter


@pytest.fixture(params=["with hard links", "without hard links"])
def filesystem(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(source: Path, path: Path) -> None:
        del source, path
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    if request.param == "without hard links":
        monkeypatch.setattr(os, "link", refuse)


@pytest.mark.usefixtures("filesystem")
@pytest.mark.parametrize("force", [False, True])
def test_a_result_appears_when_it_is_whole(tmp_path: Path, *, force: bool) -> None:
    path = tmp_path / "a.csv.gz"
    with atomic_write(path, force=force) as temporary:
        temporary.write_text("data")
        assert temporary.parent == tmp_path
        assert temporary.suffixes == [".csv", ".gz"]
        assert not path.exists()
    assert [(item.name, item.read_text()) for item in tmp_path.iterdir()] == [("a.csv.gz", "data")]


@pytest.mark.usefixtures("filesystem")
@pytest.mark.parametrize("kind", ["file", "link", "dangling link"])
def test_a_name_that_is_taken_while_a_result_is_written_is_not_replaced(tmp_path: Path, kind: str) -> None:
    path, other = tmp_path / "a.h5", tmp_path / "other"
    if kind == "link":
        other.write_text("somebody's")
    take = (lambda: path.write_text("somebody's")) if kind == "file" else (lambda: path.symlink_to(other))
    with pytest.raises(WrongUse, match="exists"), atomic_write(path, force=False):
        take()
    assert path.is_symlink() == (kind != "file")
    assert {item.read_text() for item in tmp_path.iterdir() if item.exists()} <= {"somebody's"}


def test_a_name_that_is_taken_at_the_last_moment_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.h5"
    monkeypatch.setattr(output, "_check_replaceable", lambda *_, **__: path.write_text("somebody's"))
    with pytest.raises(WrongUse, match="--force"), atomic_write(path, force=False) as temporary:
        temporary.write_text("new")
    assert [item.read_text() for item in tmp_path.iterdir()] == ["somebody's"]


def test_force_replaces_an_ordinary_file_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "a.h5").write_text("old")
    with atomic_write(tmp_path / "a.h5", force=True) as temporary:
        temporary.write_text("new")
    assert (tmp_path / "a.h5").read_text() == "new"
    (tmp_path / "link.h5").symlink_to("a.h5")
    os.mkfifo(tmp_path / "fifo.h5")
    for name in ("link.h5", "fifo.h5"):
        with pytest.raises(WrongUse, match="never overwritten"), atomic_write(tmp_path / name, force=True) as temporary:
            temporary.write_text("newer")
    assert (tmp_path / "a.h5").read_text() == "new"
    assert len(list(tmp_path.iterdir())) == 3


def test_a_link_that_waits_under_the_temporary_name_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name cannot be guessed; somebody who could would still get nothing."""
    monkeypatch.setattr("uuid.UUID.hex", "guessed")
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / ".hil-guessed.h5").symlink_to(victim)
    with pytest.raises(WrongUse), atomic_write(tmp_path / "a.h5", force=True) as temporary:
        temporary.write_text("new")
    assert victim.read_text() == "mine"
    assert not (tmp_path / "a.h5").exists()


def test_two_writers_use_different_temporary_names(tmp_path: Path) -> None:
    with atomic_write(tmp_path / "a.h5", force=True) as one, atomic_write(tmp_path / "a.h5", force=True) as two:
        assert one != two


@pytest.mark.parametrize(
    ("failure", "remedy"),
    [
        (OSError(errno.ENOSPC, "full"), "No space left on device): make room, or name another folder"),
        (RuntimeError("errno = 28, error message = 'No space left on device'"), "device): make room, or name another"),
        (OSError(errno.EACCES, "no"), "Permission denied): name another folder"),
    ],
)
def test_a_full_disk_needs_room_and_no_option_that_a_command_may_lack(failure: Exception, remedy: str) -> None:
    with pytest.raises(WrongUse) as caught, output.writing(Path("r.html")):
        raise failure
    assert remedy in str(caught.value)
    assert " -o" not in str(caught.value)


@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_a_result_that_fails_leaves_what_was_there(tmp_path: Path, failure: BaseException) -> None:
    (tmp_path / "a.h5").write_text("old")

    def fail(temporary: Path) -> None:
        temporary.write_text("half")
        raise failure

    with pytest.raises((WrongUse, KeyboardInterrupt)), atomic_write(tmp_path / "a.h5", force=True) as temporary:
        fail(temporary)
    assert [(item.name, item.read_text()) for item in tmp_path.iterdir()] == [("a.h5", "old")]


def test_a_result_is_durable_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, synced = tmp_path / "a.h5", []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append((os.fstat(file).st_size, path.exists())))
    with atomic_write(path, force=False) as temporary:
        temporary.write_text("data")
    assert synced[0] == (4, False)
    assert synced[-1][1]


def test_an_unfinished_recording_on_a_disk_that_is_read_only_can_be_recovered_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(path: Path, flags: int) -> int:
        if flags & os.O_RDWR and path == part:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return posix.open_binary(path, flags)

    part = tmp_path / "a.h5.part"
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"kind": "sine"}), 10) as writer:
        writer.append(Row(0, time=0.0, torque=0.0, dtheta=0.0))
    monkeypatch.setattr("hil.recording.output.open_binary", read_only)
    check_ended(part)
    assert finalise(part, tmp_path / "b.h5").samples == 1
