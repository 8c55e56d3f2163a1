"""The file: what is written is what is read, at every stage, and what is not a recording is refused in a sentence."""

from __future__ import annotations

import errno
import gzip
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from drivers.servo import Status
from hil.errors import Untrustworthy, WrongUse
from hil.recording import final, integrity, reader
from hil.recording import writer as writer_module
from hil.recording.channels import CHANNELS, ROW, Row, TorqueScale
from hil.recording.final import finalise
from hil.recording.integrity import LIVE, packed
from hil.recording.output import check_output, check_unfinished, next_free, remove_unfinished
from hil.recording.reader import SCHEMA, Recording
from hil.recording.writer import Header, RecordingWriter, _software, write

from ..conftest import Maker, copied, exit_status

READINGS = list(CHANNELS)[1:-1]
DATA = Path(__file__).parent / "data"
HEADER = Header(
    profile={"kind": "chirp", "amplitude": 0.006},
    stand_toml='[stand]\nname = "x"\n',
    truth={"Kc": 0.01775},
    seed=5,
    operator_note="left hand",
    command_line="hil record",
    torque_scale=TorqueScale(0.25, "a servo"),
)


def row(seq: int) -> Row:
    readings = {name: seq + 0.01 * place for place, name in enumerate(READINGS, 1)}
    return Row(seq, **readings, status=8)


def recorded(path: Path, rows: int, *, planned: int | None = None) -> RecordingWriter:
    part = RecordingWriter(path, HEADER, planned or rows, batch=7)
    for seq in range(rows):
        part.append(row(seq))
    part.flush()
    return part


def test_the_schema_in_the_docstring_is_the_schema_of_a_written_file(tmp_path: Path) -> None:
    part = recorded(tmp_path / "a.h5", 10)
    part.event(0.5, "stop-requested", "signal 2")
    path = part.finish("done")
    text = reader.__doc__ or ""
    with h5py.File(path) as file:
        assert set(file) == {"samples", "profile", "events", "truth"}
        assert set(re.findall(r"^    /(\w+)/", text, re.MULTILINE)) == set(file)
        attributes = text[text.index("/                attrs:") : text.index("/samples/")]
        named = set(re.findall(r"\b[a-z_0-9]+\b", re.sub(r"\([^)]*\)", "", attributes.split("attrs:")[1])))
        assert named == set(file.attrs)
        assert set(file["samples"]) == set(CHANNELS)
        for name, (unit, description) in CHANNELS.items():
            dataset = file["samples"][name]
            assert (dataset.attrs["unit"], dataset.attrs["description"]) == (unit, description)
            assert (dataset.shape, dataset.dtype) == ((10,), ROW[name])
            assert dataset.fletcher32
            assert dataset.compression == "gzip"
        assert set(file["events"]) == {"time", "code", "message"}
        assert file.attrs["schema"] == SCHEMA


def test_the_torque_of_a_cell_is_stored_once_and_has_both_names(tmp_path: Path) -> None:
    for source in ("cell", "motor"):
        torque = np.random.default_rng(0).normal(size=2000)
        channels = {"time": np.arange(2000) / 500.0, "torque": torque}
        write(tmp_path / f"{source}.h5", HEADER, channels | ({"joint_torque": torque} if source == "cell" else {}))
        with h5py.File(tmp_path / f"{source}.h5") as file:
            assert (file["samples/torque"] == file["samples/joint_torque"]) == (source == "cell")
        with Recording(tmp_path / f"{source}.h5") as recording:
            assert recording.verify()
            assert np.array_equal(recording.channel("torque"), torque)
            assert np.isnan(recording.channel("joint_torque")).all() == (source == "motor")


def test_a_channel_is_compressed_as_suits_its_values(tmp_path: Path) -> None:
    """Eight random bytes in each row cannot be compressed; counts of a coarse sensor take two bytes at most."""
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 200, 5000) * np.float64(0.1)
    noise = np.asarray(rng.normal(size=5000), dtype=np.float64)
    write(tmp_path / "a.h5", HEADER, {"time": np.arange(5000) / 500.0, "dtheta": counts, "torque": noise})
    with h5py.File(tmp_path / "a.h5") as file:
        size = {name: file["samples"][name].id.get_storage_size() / 5000 for name in ("time", "dtheta", "torque")}
        assert (size["time"] < 1.5, size["dtheta"] < 2.0, 7.0 < size["torque"] < 8.1) == (True, True, True)
    with Recording(tmp_path / "a.h5") as recording:
        assert recording.verify()
        assert np.array_equal(recording.channel("dtheta"), counts)


def test_blocks_that_repeat_are_read_as_they_were_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(final, "BLOCK", 8)
    torque = np.repeat([0.1, 0.1, 0.2, 0.2, 0.1], [8, 8, 8, 8, 5])
    write(tmp_path / "a.h5", HEADER, {"time": np.arange(37.0), "torque": torque})
    with Recording(tmp_path / "a.h5") as recording:
        assert recording.verify()
        assert np.array_equal(recording.channel("torque"), torque)
        assert np.isnan(recording.channel("dtheta")).all()


@pytest.mark.parametrize("stage", ["live", "final"])
def test_both_stages_read_the_same(tmp_path: Path, stage: str) -> None:
    part = recorded(tmp_path / "a.h5", 30, planned=30 if stage == "final" else 50)
    part.event(0.25, "note", "half way")
    path = part.finish("done") if stage == "final" else part.path
    part.close()
    with Recording(path) as recording:
        assert len(recording) == 30
        assert recording.live == (stage == "live")
        assert recording.complete == (stage == "final")
        expected = np.array([row(seq) for seq in range(30)], dtype=ROW)
        for name in CHANNELS:
            np.testing.assert_array_equal(recording.channel(name), expected[name].astype(float))
        np.testing.assert_array_equal(np.concatenate([rows for _, rows in recording.rows(block=7)]), expected)
        assert recording.profile == {"kind": "chirp", "amplitude": 0.006}
        assert recording.truth() == {"Kc": 0.01775}
        assert recording.stand_toml == HEADER.stand_toml
        assert recording.attributes["seed"] == 5
        assert [(event.time, event.code, event.message) for event in recording.events()] == [(0.25, "note", "half way")]
        assert recording.verify()


def change(path: Path, at: int, data: bytes) -> None:
    with path.open("rb+") as file:
        file.seek(at)
        file.write(data)


def offset_of(part: Path, name: str) -> int:
    with h5py.File(part) as file:
        return int(file[name].id.get_offset())


@pytest.mark.parametrize("channel", ["seq", "torque", "status"])
def test_a_damaged_row_of_a_part_counts_as_lost_and_costs_no_other(tmp_path: Path, channel: str) -> None:
    part = recorded(tmp_path / "a.h5", 12, planned=20)
    part.close()
    within = next(at for at, name in enumerate(CHANNELS) if name == channel) * 8
    change(part.path, offset_of(part.path, "live") + 4 * LIVE.itemsize + within + 1, b"\x55")
    with Recording(part.path) as recording:
        assert (len(recording), recording.damaged, recording.verify()) == (12, 1, False)
        assert np.flatnonzero(np.isnan(recording.channel("torque"))).tolist() == [4]
        assert recording.channel("status")[4] == Status.BAD_REPLY
    assert finalise(part.path, tmp_path / "b.h5")[:3] == (12, 1, True)
    with Recording(tmp_path / "b.h5") as recording:
        assert recording.verify()
        np.testing.assert_array_equal(recording.channel("seq"), np.arange(12.0))
        assert np.flatnonzero(np.isnan(recording.channel("torque"))).tolist() == [4]
        assert [event.code for event in recording.events()] == ["damaged-rows"]


def test_rows_after_a_hole_are_kept_and_the_hole_counts_as_lost(tmp_path: Path) -> None:
    """A power cut may keep a later page and lose an earlier one."""
    part = recorded(tmp_path / "a.h5", 5, planned=20)
    part.close()
    change(part.path, offset_of(part.path, "live") + 8 * LIVE.itemsize, packed([row(8)]))
    with Recording(part.path) as recording:
        assert (len(recording), recording.damaged) == (9, 3)


def test_rows_that_arrive_while_a_part_is_opened_are_not_taken_for_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with recorded(tmp_path / "a.h5", 40, planned=5000) as writer:  # more than HDF5 reads ahead

        def meanwhile(table: Any) -> Any:
            monkeypatch.setattr("hil.recording.reader.intact", integrity.intact)
            for seq in range(40, 80):
                writer.append(row(seq))
            return integrity.intact(table)

        monkeypatch.setattr("hil.recording.reader.intact", meanwhile)
        monkeypatch.setattr(Recording, "_try_out", lambda _: None)
        with Recording(writer.path) as recording:
            assert recording.damaged == 0
            assert recording.verify()


def test_zeros_where_a_row_was_to_be_written_are_no_row(tmp_path: Path) -> None:
    """Some filesystems grow a file before they fill it; row 0 of zeros has the right number."""
    part = recorded(tmp_path / "a.h5", 0, planned=20)
    part.close()
    change(part.path, offset_of(part.path, "live"), bytes(20 * LIVE.itemsize))
    with Recording(part.path) as recording:
        assert len(recording) == 0


@pytest.mark.parametrize("name", ["a.h5", "a.h5.part"])
def test_a_changed_stand_is_noticed_and_is_not_made_good_by_recovering(tmp_path: Path, name: str) -> None:
    header = Header(profile={"kind": "chirp"}, stand_toml="[stand]\ngear_ratio = 1.0\n")
    part = RecordingWriter(tmp_path / "a.h5", header, 5)
    part.append(row(0))
    part.flush()
    part.close() if name.endswith(".part") else part.finish("done")
    path = tmp_path / name
    data = path.read_bytes()
    assert data.count(b"gear_ratio = 1.0") == 1 + name.endswith(".part")  # whose header stands twice
    path.write_bytes(data.replace(b"gear_ratio = 1.0", b"gear_ratio = 2.0"))
    with Recording(path) as recording:
        assert not recording.verify()
    assert not finalise(path, tmp_path / "b.h5").trusted
    with Recording(tmp_path / "b.h5") as recording:
        assert not recording.verify()
        assert len(recording) == 1


def test_a_changed_event_is_noticed(tmp_path: Path) -> None:
    part = recorded(tmp_path / "a.h5", 5)
    part.event(0.5, "stop-requested", "signal 2")
    change(part.path, offset_of(part.path, "live_events") + 45, b"X")
    with Recording(part.path) as recording:
        assert recording.events() == []
    part.event(0.6, "stop-requested", "signal 3")
    path = part.finish("done")
    path.write_bytes(path.read_bytes().replace(b"signal 3", b"signal 9"))
    with Recording(path) as recording:
        assert recording.events()[0].message == "signal 9"
        assert not recording.verify()


def test_recovering_makes_a_final_file_and_keeps_the_part(tmp_path: Path) -> None:
    part = recorded(tmp_path / "a.h5", 12, planned=40)
    part.close()
    before = part.path.read_bytes()
    finalise(part.path, tmp_path / "b.h5")
    assert part.path.read_bytes() == before
    with Recording(tmp_path / "b.h5") as recording:
        assert (len(recording), recording.complete, recording.live) == (12, False, False)
        assert recording.attributes["end_reason"] == "recovered"
        assert recording.verify()


@pytest.mark.parametrize("packed", [{"chunks": (5,)}, {"dtype": ">f8"}])
def test_rows_that_another_program_packed_anew_are_held_to_their_own_hash(
    tmp_path: Path, packed: dict[str, Any]
) -> None:
    path = recorded(tmp_path / "a.h5", 12).finish("done")
    for change, intact in ((0.0, True), (1e-9, False)):
        with h5py.File(path, "r+") as file:
            values = file["samples/torque"][()] + change
            del file["samples/torque"]
            file["samples"].create_dataset("torque", data=values, **packed)
        with Recording(path) as recording:
            assert recording.verify() is intact


def test_an_intact_recording_is_verified_without_decompressing_its_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = recorded(tmp_path / "a.h5", 12).finish("done")
    with Recording(path) as recording:
        monkeypatch.setattr(recording, "rows", None)
        assert recording.verify()


@pytest.mark.parametrize(
    ("schema", "lacking", "intact"), [(SCHEMA, "", True), (SCHEMA, "header", False), (2, "", True)]
)
def test_a_recording_is_verified_by_the_hashes_of_its_schema_and_a_changed_sample_does_not_verify(
    tmp_path: Path, schema: str | int, lacking: str, intact: bool
) -> None:
    """An earlier program kept the hash of the rows only."""
    path = recorded(tmp_path / "a.h5", 12).finish("done")
    with h5py.File(path, "r+") as file:
        for name in ("stored", "header") if schema == 2 else (lacking,) * bool(lacking):
            del file.attrs[f"sha256_{name}"]
        file.attrs["schema"] = SCHEMA if schema == SCHEMA else f"hil-recording/{schema}"
    with Recording(path) as recording:
        assert recording.verify() is intact
    with h5py.File(path, "r+") as file:
        file["samples/torque"][3] += 1e-9
    with Recording(path) as recording:
        assert not recording.verify()


def test_damaged_samples_are_reported_as_damaged(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.h5", 500).finish("done")
    with h5py.File(path) as file:
        at = file["samples"]["torque"].id.get_chunk_info(0).byte_offset
    with path.open("rb+") as raw:
        raw.seek(at + 20)
        raw.write(b"\xff\x00\xff")
    with Recording(path) as recording, pytest.raises(Untrustworthy, match="damaged"):
        recording.channel("torque")


def test_a_failed_second_stage_leaves_the_part_and_no_half_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = recorded(tmp_path / "a.h5", 12)

    def full(file: int) -> None:
        del file
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(WrongUse, match="No space left"):
        part.finish("done")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a.h5.part"]
    with Recording(part.path) as recording:
        assert len(recording) == 12


def test_a_full_disk_is_refused_before_anything_moves(tmp_path: Path) -> None:
    """A real refusal by the kernel: the process may write no file larger than 100 kB."""

    def refused() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        with pytest.raises(WrongUse, match="cannot be written"):
            RecordingWriter(tmp_path / "a.h5", HEADER, 100_000)

    assert exit_status(copied(refused)) == 0
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_for_both_stages_is_refused_before_anything_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5 ends in a segmentation fault on a disk that fills up under it, so the room is counted beforehand."""
    rows = 10_000 * ROW.itemsize
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1.5 * rows))
    with pytest.raises(WrongUse, match=rf"the disk has {1.5 * rows / 1e6:.1f} MB free"):
        RecordingWriter(tmp_path / "a.h5", HEADER, 10_000)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_filled_up_meanwhile_keeps_the_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = recorded(tmp_path / "a.h5", 12)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(WrongUse, match="make room"):
        part.finish("done")
    assert [item.name for item in tmp_path.iterdir()] == ["a.h5.part"]


def test_the_next_free_name_counts_unfinished_recordings_too(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    assert next_free(folder).name == "run1.h5"
    for name in ("run1.h5", "run7.h5.part", "runner.h5", "run9.csv"):
        (folder / name).touch()
    assert next_free(folder).name == "run8.h5"


def test_nothing_is_overwritten_without_force(tmp_path: Path) -> None:
    (tmp_path / "a.h5").touch()
    recorded(tmp_path / "b.h5", 5).close()
    with pytest.raises(WrongUse, match="--force"):
        check_output(tmp_path / "a.h5", force=False)
    with pytest.raises(WrongUse, match="--force"):
        check_unfinished(tmp_path / "b.h5")


def test_looking_whether_a_name_is_free_removes_nothing(tmp_path: Path) -> None:
    for name in ("a.h5", "a.h5.part"):
        (tmp_path / name).write_text("data")
    check_output(tmp_path / "a.h5", force=True)
    assert sorted(item.read_text() for item in tmp_path.iterdir()) == ["data", "data"]


def test_what_is_read_is_never_overwritten_whatever_it_is_called(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("data")
    (tmp_path / "b.csv").symlink_to("a.csv")
    for name in ("a.csv", "b.csv", "../" + tmp_path.name + "/a.csv"):
        with pytest.raises(WrongUse, match="is also an input"):
            check_output(tmp_path / name, force=True, inputs=[tmp_path / "a.csv"])


def test_an_unfinished_recording_can_be_removed_and_a_live_one_cannot(tmp_path: Path) -> None:
    remove_unfinished(tmp_path / "a.h5")  # there is none
    part = recorded(tmp_path / "a.h5", 5)
    with pytest.raises(WrongUse, match="is being recorded"):
        remove_unfinished(tmp_path / "a.h5")
    with Recording(part.path) as recording:
        assert len(recording) == 5
    part.close()
    remove_unfinished(tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_a_live_recording_of_another_process_is_not_removed(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path\n"
        "from hil.errors import WrongUse\n"
        "from hil.recording.output import remove_unfinished\n"
        "try: remove_unfinished(Path(sys.argv[1]))\n"
        "except WrongUse as error: print(error)\n"
    )
    with recorded(tmp_path / "a.h5", 5) as part:
        other = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "a.h5")], check=True, capture_output=True, text=True
        )
        assert "is being recorded" in other.stdout
        assert part.path.exists()


def test_a_live_recording_can_be_watched_with_any_reader(tmp_path: Path) -> None:
    with recorded(tmp_path / "a.h5", 5) as part, h5py.File(part.path) as file:
        assert file["live"][3]["seq"] == 3


def test_a_part_is_discarded_only_where_it_is_ours(tmp_path: Path) -> None:
    part = RecordingWriter(tmp_path / "a.h5", HEADER, 5)
    part.path.unlink()
    part.path.write_text("somebody else's")
    part.discard()
    assert part.path.read_text() == "somebody else's"


def test_a_temporary_file_of_somebody_elses_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "a.h5.tmp").write_text("my own data")
    recorded(tmp_path / "a.h5", 5).finish("done")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a.h5", "a.h5.tmp"]
    assert (tmp_path / "a.h5.tmp").read_text() == "my own data"


@pytest.mark.parametrize("planned", [0, 40])
def test_a_part_without_a_row_is_recovered_as_an_empty_recording(tmp_path: Path, planned: int) -> None:
    part = RecordingWriter(tmp_path / "a.h5", HEADER, planned)
    part.close()
    assert finalise(part.path, tmp_path / "a.h5")[:3] == (0, 0, True)
    with Recording(tmp_path / "a.h5") as recording:
        assert (len(recording), recording.verify()) == (0, True)
        assert recording.truth() == {"Kc": 0.01775}


@pytest.mark.parametrize("where", ["hil.recording.writer.write_at", "os.fsync"])
def test_a_disk_that_fails_during_a_run_is_reported_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    failed = threading.Event()

    def fail(*words: object) -> int:
        failed.set()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(len(words)))

    part = recorded(tmp_path / "a.h5", 12, planned=100)
    monkeypatch.setattr(where, fail)
    if where == "os.fsync":  # asked for by a thread of its own
        assert failed.wait(10.0)
        part._syncer.join()
    with pytest.raises(Untrustworthy, match="No space left on device"):
        recorded_more(part, 7)
    with pytest.raises(Untrustworthy):
        part.event(0.5, "note", "half way")
    part.close()
    monkeypatch.undo()
    with Recording(part.path) as recording:
        assert len(recording) == 12


def recorded_more(part: RecordingWriter, rows: int) -> None:
    for seq in range(len(part), len(part) + rows):
        part.append(row(seq))


def test_an_output_without_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WrongUse, match="is not a folder"):
        check_output(tmp_path / "none" / "a.h5", force=False)
    with pytest.raises(WrongUse, match="is a folder"):
        check_output(tmp_path, force=True)


Spoil = Callable[[Path], object]


def edited(edit: Callable[[h5py.File], object]) -> Spoil:
    """Return a function that makes a recording and edits it."""

    def spoil(path: Path) -> None:
        recorded(path, 5).finish("done")
        with h5py.File(path, "r+") as file:
            edit(file)

    return spoil


def replacing(name: str, values: Any = None, *shape: Any, **settings: Any) -> Spoil:
    """Return a function that makes a recording with other data under a name; None: without them."""

    def edit(file: h5py.File) -> None:
        del file[name]
        if shape:
            file.create_dataset(name, *shape, **settings)
        elif values is not None:
            file[name] = values

    return edited(edit)


def _foreign(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["x"] = [1.0]


def _external(path: Path) -> None:
    secret = path.with_name("secret")
    secret.write_bytes(b"\x00" * 40)
    replacing("samples/torque", None, (5,), "<f8", external=[(str(secret), 0, 40)])(path)


@pytest.mark.usefixtures("damaged_files")
@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda _: None, "No such file"),
        (lambda path: path.write_text("time,torque\n"), "is not HDF5"),
        (Path.touch, "is empty: use another copy"),
        (lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(40)), "is cut off or damaged: copy it again"),
        (_foreign, "hil import"),
        (
            edited(lambda file: file.attrs.update(schema="hil-recording/9", software=json.dumps({"hil": "7.1.0"}))),
            "'hil-recording/9', written by hil 7.1.0; this hil reads hil-recording/1, hil-recording/2, hil-",
        ),
        (replacing("samples/torque", np.zeros(4)), "unequal length"),
        (replacing("samples/dtheta"), "lacks dtheta"),
        (replacing("samples/dtheta", np.array([b"a"] * 5)), "one column of numbers"),
        (_external, "another file"),
        (replacing("samples/torque", h5py.ExternalLink("elsewhere.h5", "/x")), "a link"),
        (os.mkfifo, "is not a file"),
    ],
)
def test_what_is_no_recording_is_refused_in_a_sentence(tmp_path: Path, spoil: Spoil, expected: str) -> None:
    path = tmp_path / "a.h5"
    spoil(path)
    with pytest.raises(WrongUse, match=expected) as refusal:
        Recording(path)
    assert str(path) in str(refusal.value)
    assert len(str(refusal.value).splitlines()) == 1


def test_an_imported_recording_has_every_channel(make_recording: Maker) -> None:
    with Recording(make_recording(samples=100)) as recording:
        assert len(recording) == 100
        assert recording.complete
        assert recording.verify()
        assert np.isnan(recording.channel("temperature")).all()
        np.testing.assert_array_equal(recording.channel("seq"), np.arange(100.0))


def test_a_write_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="broadcast"):
        write(tmp_path / "a.h5", HEADER, {"time": np.zeros(3), "torque": np.zeros(4)})
    assert list(tmp_path.iterdir()) == []


def test_a_checkout_that_was_not_installed_records_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def known(name: str) -> str:
        if name == "hil":
            raise PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(writer_module, "_software", _software)  # not one that remembers
    monkeypatch.setattr(writer_module, "version", known)
    with Recording(recorded(tmp_path / "a.h5", 5).finish("done")) as recording:
        software = json.loads(recording.attributes["software"])
    assert "hil" not in software
    assert software["numpy"] == np.__version__


def test_a_row_without_readings_holds_its_number_only() -> None:
    seq, *readings, status = Row(4)
    assert (seq, status) == (4, 0)
    assert np.isnan(readings).all()


@pytest.mark.parametrize("name", ["version1.h5", "version2.h5.part"])
def test_a_recording_of_an_earlier_schema_is_read_by_the_names_of_today(tmp_path: Path, name: str) -> None:
    """The files were written by the last hil of their schema: `hil record --profile chirp --soft 0.1`, 41 samples."""
    path = tmp_path / name
    path.write_bytes(gzip.decompress((DATA / f"{name}.gz").read_bytes()))
    finalise(path, tmp_path / "new.h5")
    with Recording(path) as old, Recording(tmp_path / "new.h5") as new:
        assert old.attributes["schema"] == f"hil-recording/{name[7]}"
        assert new.attributes["schema"] == SCHEMA
        assert (old.live, len(old), len(new)) == (name.endswith(".part"), 41, 41)
        assert new.profile == old.profile
        assert {"mode": "torque", "fade": 0.1, "kind": "chirp"}.items() <= old.profile.items()
        assert not {"soft", "quantity"} & set(old.profile)
        assert [event.message for event in new.events()] == ["half of it"]
        assert old.truth() == new.truth() != {}
        assert old.verify()
        assert new.verify()
        for channel in CHANNELS:
            np.testing.assert_array_equal(new.channel(channel), old.channel(channel))


def _many_rows(file: h5py.File) -> None:
    for name in CHANNELS:
        del file["samples"][name]
        file["samples"].create_dataset(name, (10**9,), ROW[name], chunks=(4096,))


@pytest.mark.study
@pytest.mark.usefixtures("damaged_files")
@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (edited(_many_rows), "declares 1000000000 rows"),
        (replacing("events/time", None, (10**8,), "<f8", chunks=(1000,)), "declares more than"),
        (
            replacing("samples/torque", None, (5,), "<f8", chunks=(2**27,), maxshape=(None,), compression="gzip"),
            "chunks of 1073",
        ),
    ],
)
def test_declared_sizes_are_not_believed(tmp_path: Path, spoil: Spoil, expected: str) -> None:
    spoil(tmp_path / "a.h5")
    with pytest.raises(WrongUse, match=expected):
        Recording(tmp_path / "a.h5")


@pytest.mark.usefixtures("damaged_files")
def test_a_program_that_ignores_the_end_of_its_children_can_open_a_recording(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.h5", 5).finish("done")
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        with Recording(path) as recording:
            assert len(recording) == 5
    finally:
        signal.signal(signal.SIGCHLD, before)


@pytest.mark.usefixtures("damaged_files")
@pytest.mark.parametrize("fault", [pytest.param("hangs", marks=pytest.mark.study), "crashes", "needs much memory"])
def test_a_file_on_which_the_library_fails_is_refused_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    """In the library itself, where no exception and no signal handler of Python's runs."""
    path = recorded(tmp_path / "a.h5", 5).finish("done")

    def fail(*words: object) -> None:
        del words
        if fault == "hangs":
            signal.signal(signal.SIGXCPU, signal.SIG_DFL)
            while True:
                pass
        if fault == "crashes":
            os.kill(os.getpid(), signal.SIGSEGV)
        bytearray(1 << 31)

    monkeypatch.setattr(reader, "_TRIAL_TIME", 1)
    monkeypatch.setattr(reader, "refuse_foreign_storage", fail)
    with pytest.raises(WrongUse, match="is damaged"):
        Recording(path)
