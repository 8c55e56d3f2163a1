"""ROS 2 bags into recordings: a topic, a joint, and what the bag has where these are not in it."""

from __future__ import annotations

import os
import sqlite3
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.errors import WrongUse
from hil.exchange.importer import Column, Imported, import_table
from hil.exchange.readers import bags
from hil.recording.reader import Recording

pytest.importorskip("rosbags", reason="ROS BAGS NOT TESTED: rosbags is missing, pip install '.[test]'")

TIME = np.arange(200) / 100.0
STATE = ("finger", 0.3 * np.sin(5.0 * TIME), 1.5 * np.cos(5.0 * TIME), 0.006 * np.sin(5.0 * TIME))
THUMB = ("thumb", 9.0 + 0.0 * TIME, 0.0 * TIME, 7.0 + 0.0 * TIME)
WRENCH = "geometry_msgs/msg/WrenchStamped"


def bag(path: Path, states: Sequence[Any] = (STATE, THUMB), *, storage: str = "sqlite3", stamped: bool = True) -> Path:
    """Write /joint_states and a /wrench as `ros2 bag record` does, 2 s at 100 Hz."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types: Any = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        joint = writer.add_connection("/joint_states", bags.JOINT_STATE, typestore=store)
        cell = writer.add_connection("/wrench", WRENCH, typestore=store)
        for index, time in enumerate(TIME):
            now = 1_700_000_000_000_000_000 + round(time * 1e9)
            sec, nanosec = divmod(now, 10**9) if stamped else (0, 0)
            stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            columns = [np.array([state[part][index] for state in states]) for part in (1, 2, 3)]
            state = types[bags.JOINT_STATE](header, [one[0] for one in states], *columns)
            received = now + (1000 if stamped else 0)
            writer.write(joint, received, store.serialize_cdr(state, bags.JOINT_STATE))
            wrench = types["geometry_msgs/msg/Wrench"](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, float(time)))
            writer.write(cell, received, store.serialize_cdr(types[WRENCH](header, wrench), WRENCH))
    return path


def imported(
    tmp_path: Path, source: Path, topic: str | None = "/joint_states", joint: str | None = "finger"
) -> Imported:
    return import_table(source, tmp_path / "a.h5", {}, [], topic=topic, joint=joint, force=True)


@pytest.mark.parametrize(("storage", "stamped"), [("sqlite3", True), ("mcap", False)])
def test_a_joint_of_a_bag_becomes_a_recording(tmp_path: Path, storage: str, *, stamped: bool) -> None:
    folder = bag(tmp_path / "bag", storage=storage, stamped=stamped)
    for source in (folder, *folder.glob("*.mcap"), *folder.glob("*.db3")):  # the folder, and its one file
        done = imported(tmp_path, source)
        assert done.units == {"time": "s", "torque": "N*m", "dtheta": "rad"}
        with Recording(tmp_path / "a.h5") as recording:
            np.testing.assert_allclose(recording.channel("time"), TIME, atol=1e-9)
            np.testing.assert_array_equal(recording.channel("dtheta"), STATE[1])
            np.testing.assert_array_equal(recording.channel("torque"), STATE[3])


@pytest.mark.study
def test_another_message_is_read_by_the_paths_of_its_numbers(tmp_path: Path) -> None:
    source = bag(tmp_path / "bag")
    columns = {"torque": Column("wrench.torque.z", "N*m"), "dtheta": Column("wrench.torque.x", "rad")}
    columns["time"] = Column("time")
    import_table(source, tmp_path / "a.h5", columns, [], topic="/wrench")
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("torque"), TIME)
    with pytest.raises(WrongUse, match=r"the unit of 'wrench.torque.z' \(0 to 1.99\): give it with --torque-unit"):
        import_table(source, tmp_path / "b.h5", columns | {"torque": Column("wrench.torque.z")}, [], topic="/wrench")


@pytest.mark.parametrize(
    ("topic", "joint", "said"),
    [
        ("/joint_state", "finger", r"no topic /joint_state; did you mean '/joint_states'\? it has /joint_states"),
        ("/joint_states", "fingr", r"has no joint 'fingr'; it has finger, thumb"),
        ("/joint_states", None, r"name the joint with --joint; it has finger, thumb"),
        ("/wrench", "finger", r"/wrench holds geometry_msgs/msg/WrenchStamped, which has no joints"),
        ("/wrench", None, r"name the columns of .* with --time, --torque and --dtheta; it has time \[s\], wrench"),
    ],
)
def test_what_a_bag_does_not_have_is_said_with_what_it_has(
    tmp_path: Path, topic: str, joint: str | None, said: str
) -> None:
    with pytest.raises(WrongUse, match=said):
        imported(tmp_path, bag(tmp_path / "bag"), topic, joint)
    assert not (tmp_path / "a.h5").exists()


def test_a_further_joint_of_a_joint_state_that_moved_too_is_named(tmp_path: Path) -> None:
    thumb = ("thumb", 0.9 * STATE[1], STATE[2], STATE[3])
    (warning,) = imported(tmp_path, bag(tmp_path / "bag", [STATE, thumb])).diagnostics
    assert warning.code == "other-joints"
    assert "thumb" in warning.message


def test_the_only_joint_of_the_only_joint_states_need_not_be_named(tmp_path: Path) -> None:
    assert imported(tmp_path, bag(tmp_path / "bag", [STATE]), None, None).samples == 200


def test_a_joint_state_without_effort_is_refused(tmp_path: Path) -> None:
    nothing = np.full(200, np.nan)
    with pytest.raises(WrongUse, match=r"name the torque with --torque, TOPIC:PATH for .* it has .*/wrench \("):
        imported(tmp_path, bag(tmp_path / "bag", [("finger", STATE[1], STATE[2], nothing)]))


@pytest.mark.study
def test_a_type_whose_definition_the_bag_lacks_is_named(tmp_path: Path) -> None:
    [source] = bag(tmp_path / "bag").glob("*.db3")
    with closing(sqlite3.connect(source)) as database:
        database.execute("DELETE FROM message_definitions")
        database.execute("UPDATE topics SET type = 'my_msgs/msg/Cell' WHERE name = '/wrench'")
        database.commit()
    with pytest.raises(WrongUse, match=r"lacks the definition of my_msgs/msg/Cell, .* ros2 bag convert"):
        bags.columns(source, "/wrench", None)


def test_an_mcap_of_other_messages_is_named_as_such(tmp_path: Path) -> None:
    mcap = pytest.importorskip("mcap.writer")
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = mcap.Writer(file)
        writer.start()
        channel = writer.register_channel("/cell", "json", 0)
        writer.add_message(channel, 10**18, b'{"tau": 1.0}', 10**18)
        writer.finish()
    with pytest.raises(WrongUse, match="an MCAP whose messages are not those of ROS 2"):
        bags.columns(tmp_path / "a.mcap", "/cell", None)


@pytest.mark.parametrize("damage", ["junk", "empty", "bytes"])
def test_a_damaged_bag_is_one_sentence(tmp_path: Path, damage: str) -> None:
    [source] = bag(tmp_path / "bag", storage="mcap").glob("*.mcap")
    data = bytearray(source.read_bytes())
    if damage == "bytes":
        data[200:2000:7] = bytes(len(data[200:2000:7]))
    broken = {"junk": b"junk" * 999, "empty": b"", "bytes": data}[damage]
    (tmp_path / "b.mcap").write_bytes(bytes(broken))
    with pytest.raises(
        WrongUse, match=r"b\.mcap.*(damaged, or not what its name says|is empty|has no mess)"
    ) as refusal:
        imported(tmp_path, tmp_path / "b.mcap")
    assert "Errno" not in str(refusal.value)


ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT count(*) AS schema_version FROM c"


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (f"CREATE VIEW schema AS {ENDLESS}", "it has the view 'schema'"),
        ("ALTER TABLE messages ADD data AS (zeroblob(1 << 30))", "it has the generated column 'data'"),
        ('CREATE VIEW "DATA" AS SELECT 1', "is damaged, or is not a ROS 2 bag"),
    ],
)
def test_a_database_of_more_than_stored_values_is_no_bag(tmp_path: Path, made: str, said: str) -> None:
    path = tmp_path / "a # 100%.db3"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        database.execute("CREATE TABLE messages(id, topic_id, timestamp)")
        database.execute(made)
        database.commit()
    path.write_bytes(path.read_bytes().replace(b"DATA", b"D\xff\xfeA"))
    with pytest.raises(WrongUse, match=said):
        bags.columns(path, None, None)


def test_nothing_but_files_is_read_in_the_folder_of_a_bag(tmp_path: Path) -> None:
    """Its description names its files, which may have any name: a FIFO would be waited for."""
    folder = bag(tmp_path / "bag")
    (folder / "note.txt").touch()
    imported(tmp_path, folder)
    os.mkfifo(folder / "fifo.bin")
    description = folder / "metadata.yaml"
    description.write_text(description.read_text().replace("bag.db3", "fifo.bin"))
    with pytest.raises(WrongUse, match=r"fifo\.bin is not a file"):
        imported(tmp_path, folder)


def test_a_bag_without_its_library_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = bag(tmp_path / "bag")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(WrongUse, match=r"needs rosbags: pip install 'hil\[ros\]'"):
        imported(tmp_path, source)


# --- PlotJuggler -----------------------------------------------------------------------------------------------------


@pytest.mark.study
def test_a_table_of_several_topics_is_read_where_a_row_has_a_reading(tmp_path: Path) -> None:
    """As PlotJuggler exports them: a row has empty cells for the topics that were not received at its time."""
    lines = ["__time,/joint_states/finger/position,/joint_states/finger/effort,/battery/v"]
    for time, position, effort in zip(TIME.tolist(), STATE[1].tolist(), STATE[3].tolist(), strict=True):
        lines += [f"{1.7e9 + time:.6f},{position!r},{effort!r},", f"{1.7e9 + time + 0.003:.6f},,,12.5"]
    (tmp_path / "pj.csv").write_text("\n".join(lines) + "\n")
    position, effort = Column("/joint_states/finger/position", "rad"), Column("/joint_states/finger/effort", "N*m")
    columns = {"time": Column("__time", "s"), "torque": effort, "dtheta": position}
    assert import_table(tmp_path / "pj.csv", tmp_path / "a.h5", columns, []).samples == 200
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("time"), TIME, atol=1e-6)
        np.testing.assert_array_equal(recording.channel("dtheta"), STATE[1])
    battery = columns | {"torque": Column("/battery/v", "N*m")}
    assert "are read as those of one clock" in import_table(tmp_path / "pj.csv", tmp_path / "b.h5", battery, []).said


def test_a_topic_of_another_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t [s],q [N*m]\n0,1\n")
    with pytest.raises(WrongUse, match="is no bag and has no topics or joints: leave out --topic"):
        imported(tmp_path, tmp_path / "a.csv")


def test_two_topics_are_joined_on_the_clock_of_the_bag(tmp_path: Path) -> None:
    source = bag(tmp_path / "bag")
    columns = {"torque": Column("/wrench:wrench.torque.z", "N*m"), "dtheta": Column("/joint_states:position")}
    done = import_table(source, tmp_path / "a.h5", columns, [], joint="finger")
    assert "one clock" in done.said
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("torque"), TIME, atol=1e-6)
        np.testing.assert_allclose(recording.channel("dtheta"), STATE[1], atol=1e-6)


def test_a_bag_without_its_end_or_its_description_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", storage="mcap")
    (folder / "metadata.yaml").unlink()
    [file] = folder.glob("*.mcap")
    assert imported(tmp_path, folder).samples == 200
    file.write_bytes(file.read_bytes()[:40_000])
    done = imported(tmp_path, folder)
    assert 100 < done.samples < 200
    assert "has no end" in done.diagnostics[1].message
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_array_equal(recording.channel("dtheta"), STATE[1][: done.samples])
    file.write_bytes(file.read_bytes()[:20])
    with pytest.raises(WrongUse, match="no whole record"):
        imported(tmp_path, folder)
