"""Read columns from a ROS 2 bag: one topic of a rosbag2 folder, of an MCAP or of a .db3 file, by the library
rosbags.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from types import MappingProxyType
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse, meant
from hil.exchange import nested
from hil.exchange.headings import heading, listed
from hil.recording.channels import CHANNELS
from hil.recording.input import bounded, open_input

Answer = TypeVar("Answer")
Array = NDArray[np.float64]

SUFFIXES = frozenset({".mcap", ".db3", ".bag"})
JOINT_STATE = "sensor_msgs/msg/JointState"
SAMPLE = "hil_msgs/msg/Sample"
"""The type of the messages that `hil export` writes: each channel is a field."""
UNITS: Mapping[str, str] = MappingProxyType({"position": "rad", "velocity": "rad/s", "effort": "N*m"})
"""The units of the fields of a JointState for a rotary joint, as ROS defines them."""

_LARGEST = 1 << 36  # bytes of a file, which is read message by message
_DESCRIPTION, _DESCRIBED = "metadata.yaml", 1 << 24  # of a folder, and its largest size, bytes
_DATABASE = b"SQLite format 3\0"  # at the begin of one
_MCAP = b"\x89MCAP0\r\n"  # at the begin and at the end of one
_CHUNK, _TO_COMPRESSION = 0x06, 28  # kind of record, and bytes in it before the name of its compression
_END_RECORDS = frozenset({0x02, 0x0F})  # the records behind the data
_NO_TABLES = """
    SELECT type, name FROM sqlite_master WHERE type NOT IN ('table', 'index') OR sql LIKE 'create virtual%'
    UNION ALL SELECT 'generated column', x.name FROM sqlite_master AS m, pragma_table_xinfo(m.name) AS x
    WHERE m.type = 'table' AND x.hidden > 1 LIMIT 1
"""


def is_bag(source: Path) -> bool:
    """Return whether a path is a ROS 2 bag: the folder of a bag, also without its description, or one of its files."""
    with suppress(OSError):  # a name that is too long
        return source.suffix.lower() in SUFFIXES or (source / _DESCRIPTION).is_file() or bool(_stored(source))
    return False


def columns(
    source: Path, topic: str | None, joint: str | None, *, several: bool = False
) -> tuple[dict[str, Array], list[str]]:
    """Return the numbers in the messages of a topic, (n,) each, by heading, and sentences about what is lost of the
    bag. "time [s]" starts at the first message.

    topic: None if the bag has only one topic of joint states, or is an export of hil. joint: None if the joint states
    have one joint. several: whether "time [s]" starts at the first message of the bag, as for its other topics. Raises
    WrongUse, with the list of topics or joints in the bag.
    """
    lost = list[str]()
    return _opened(
        source, lost, lambda reader: _read(source, reader, topic, joint, reader.start_time if several else None)
    ), lost


def topics(source: Path) -> str:
    """Return the topics of a bag with their types, in words for a message. Raises WrongUse."""
    return _opened(source, [], lambda reader: _has({one.topic: one.msgtype for one in reader.connections}))


def _opened(source: Path, lost: list[str], work: Callable[[Any], Answer]) -> Answer:
    """Return the result of `work` with the reader of a bag. lost: gets sentences about what is lost of it."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise WrongUse(f"{source}: a ROS 2 bag needs rosbags: pip install 'hil[ros]', or use CSV") from None

    def answer() -> Answer:
        _check_files(source)
        try:
            # the types are for bags that do not hold the definitions of their messages
            with (
                _whole(source, lost) as bag,
                AnyReader([bag], default_typestore=get_typestore(Stores.LATEST)) as reader,
            ):
                return work(reader)
        except AnyReaderError as error:
            if "Profile" not in str(error):
                raise
            raise WrongUse(
                f"{source} is an MCAP whose messages are not those of ROS 2, but such as JSON or protobuf, which hil "
                "does not read: save the topic as CSV, for example with PlotJuggler"
            ) from None

    return bounded(source, answer)


@contextmanager
def _whole(source: Path, lost: list[str]) -> Iterator[Path]:
    """Yield the file to read: of an MCAP without its end, which a killed recorder leaves, a copy of its whole records.

    A folder without its description stands for the only file in it. lost: gets a sentence about what is missing.
    """
    if source.is_dir() and not (source / _DESCRIPTION).is_file():
        [source] = _stored(source)
        lost.append("the folder has no metadata.yaml, as after a killed recorder; its file is read")
    if source.suffix.lower() != ".mcap" or _ends(source):
        yield source
        return
    size = source.stat().st_size
    with NamedTemporaryFile(suffix=".mcap") as copy, source.open("rb") as file:
        copy.write(file.read(len(_MCAP)))
        for record in _records(file, size):
            copy.write(record)
        copy.write(b"\x02" + (20).to_bytes(8, "little") + bytes(20) + _MCAP)
        copy.flush()
        whole = copy.tell() - 29 - 2 * len(_MCAP)
        if not whole:
            raise WrongUse(f"{source} is cut off, and no whole record of it is left: use another copy of the file")
        lost.append(
            f"the file has no end, as after a killed recorder: {whole} of {size} bytes are whole records and are read, "
            "and the rest is lost"
        )
        yield Path(copy.name)


def _records(file: BinaryIO, size: int) -> Iterator[bytes]:
    """Yield the whole records of an MCAP of `size` bytes. Of a chunk that is cut off, yield those in it, if it is not
    compressed.
    """
    while len(head := file.read(9)) == 9 and head[0] not in _END_RECORDS:
        length = int.from_bytes(head[1:], "little")
        if length <= size - file.tell():
            yield head + file.read(length)
        elif head[0] != _CHUNK or file.read(_TO_COMPRESSION + 4)[_TO_COMPRESSION:] != bytes(4):
            return
        else:
            file.read(8)  # the length of the records, which follow


def _ends(source: Path) -> bool:
    with source.open("rb") as file:
        is_mcap = file.read(len(_MCAP)) == _MCAP
        if is_mcap:
            file.seek(-len(_MCAP), os.SEEK_END)
        return not is_mcap or file.read() == _MCAP


def _stored(folder: Path) -> list[Path]:
    with suppress(OSError):
        return sorted(one for one in folder.iterdir() if one.suffix in {".mcap", ".db3"})
    return []


def _check_files(source: Path) -> None:
    """Raise WrongUse for a bag's file that rosbags must not open. The bag's description may name any file in the
    folder, such as a FIFO, for which rosbags would wait forever.
    """
    if source.is_dir() and not (source / _DESCRIPTION).is_file() and len(files := _stored(source)) != 1:
        raise WrongUse(
            f"{source} is a folder without metadata.yaml, with {len(files)} files of a bag: name one of them, or "
            "complete the folder with ros2 bag reindex"
        )
    for path in source.iterdir() if source.is_dir() else [source]:
        if path.suffix not in SUFFIXES and (path.is_dir() or (path.is_file() and not path.stat().st_size)):
            continue
        with open_input(path, largest=_DESCRIBED if path.name == _DESCRIPTION else _LARGEST) as file:
            is_database = file.read(len(_DATABASE)) == _DATABASE
        if is_database:
            _check_tables(path)


def _check_tables(path: Path) -> None:
    """Raise WrongUse for a database that contains more than tables of stored values: reading a view may never end, and
    Ctrl-C does not stop it.
    """
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)) as database:
            found = database.execute(_NO_TABLES).fetchone()
    except (sqlite3.Error, UnicodeError) as error:
        raise WrongUse(f"{path} is damaged, or is not a ROS 2 bag ({error}): use another copy of the file") from None
    if found is not None:
        raise WrongUse(f"{path} is no ROS 2 bag, which stores its values in tables: it has the {found[0]} {found[1]!r}")


def _read(source: Path, reader: Any, topic: str | None, joint: str | None, start: int | None) -> dict[str, Array]:
    kinds = {connection.topic: connection.msgtype for connection in reader.connections}
    topic = _topic(source, kinds, topic)
    kind = kinds[topic]
    if kind not in reader.typestore.types:
        raise WrongUse(
            f"{source} lacks the definition of {kind}, the type of {topic}, so no message can be read: convert "
            "the bag to MCAP, which keeps definitions, where the type is installed: ros2 bag convert"
        )
    found = nested.columns(f"{source}: {topic}", _messages(reader, topic), joint, alone=kind == JOINT_STATE)
    if not found.read:
        raise WrongUse(f"{source}: {topic} has no messages: name another --topic; {_has(kinds)}")
    if joint is not None and not found.joints:
        raise WrongUse(f"{source}: {topic} holds {kind}, which has no joints: omit --joint, or name another --topic")
    if not found.stamps or (found.joint is None and kind == JOINT_STATE):
        asked = "name the joint with --joint" if joint is None else f"{topic} has no joint {joint!r}"
        raise WrongUse(f"{source}: {asked}; it has {listed(found.joints)}")
    numbers = found.values
    if kind == SAMPLE:
        return {heading(name): values for name, values in numbers.items() if name in CHANNELS}
    if found.joint is not None:  # an interface of ros2_control is in SI as a joint state is
        numbers = {
            f"{name} [{UNITS[field]}]" if (field := name.partition(".")[0]) in UNITS else name: values
            for name, values in numbers.items()
            if values.dtype.kind != "f" or np.isfinite(values).any()
        }
    return numbers if "time" in numbers else {"time [s]": _seconds(found.stamps, start)} | numbers


def _has(kinds: Mapping[str, str]) -> str:
    return f"it has {listed([f'{name} ({kind})' for name, kind in sorted(kinds.items())])}" if kinds else "it has none"


def _topic(source: Path, kinds: Mapping[str, str], topic: str | None) -> str:
    """Return the topic to read. kinds: the type of each topic. Raises WrongUse, with the list of topics, if the topic
    is missing or not clear.
    """
    has = _has(kinds)
    if topic is not None:
        for name in (topic, f"/{topic}"):
            if name in kinds:
                return name
        raise WrongUse(f"{source} has no topic {topic}; {meant(topic, kinds)}{has}")
    for wanted in (SAMPLE, JOINT_STATE):
        of_kind = [name for name, kind in kinds.items() if kind == wanted]
        if len(of_kind) == 1:
            return of_kind[0]
    raise WrongUse(f"{source}: name the topic with --topic; {has}")


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    """Yield the messages of a topic, each with its time in ns: the stamp in the message; without a stamp, the time of
    reception.
    """
    chosen = [connection for connection in reader.connections if connection.topic == topic]
    for connection, received, raw in reader.messages(connections=chosen):
        message = reader.deserialize(raw, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        own = 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
        yield own or received, message


def _seconds(stamps: Sequence[int], start: int | None) -> Array:
    """Return times in s since `start`, None: the first. stamps: ns, integers, which a double cannot hold exactly."""
    times = np.array(stamps, dtype=np.int64)
    return np.asarray((times - (times[0] if start is None else start)) * 1e-9, dtype=np.float64)
