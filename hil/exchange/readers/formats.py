"""The table of formats: how each file is recognised, and which module reads it or which program converts it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from hil.errors import WrongUse
from hil.exchange.readers.columns import Columns
from hil.printable import quoted
from hil.recording.input import bounded, open_input

_LARGEST = 1 << 36  # bytes of a file
_BEGINNING = 1 << 12  # bytes of a file in which its kind is looked for
_ZIP, _OLE = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
TEXT, WORKBOOK = "text", "workbook"
"""The kinds of file that are read row by row."""


class _Format(NamedTuple):
    """A kind of file.

    reader: module of this folder. magic: bytes at the beginning of each file of the kind. suffixes: of the files'
    names, in lower case. needs: package and extra of hil that it needs, if hil does not depend on it. both: whether the
    magic alone is not enough.
    """

    name: str
    reader: str
    magic: tuple[bytes, ...]
    suffixes: tuple[str, ...]
    needs: tuple[str, str] | None = None
    both: bool = False


_ARROW, _BOOKS = (
    (".parquet", ".pq", ".feather", ".arrow", ".arrows", ".ipc"),
    (".xlsx", ".xlsm", ".xlsb", ".ods", ".xls"),
)
_READ = (
    _Format(
        "Parquet or Arrow", "arrow", (b"PAR1", b"ARROW1", b"FEA1", b"\xff\xff\xff\xff"), _ARROW, ("pyarrow", "parquet")
    ),
    _Format("TDMS", "tdms", (b"TDSm",), (".tdms",), ("nptdms", "tdms")),
    _Format("NumPy", "arrays", (b"\x93NUMPY",), (".npy", ".npz")),
    _Format("NumPy", "arrays", (_ZIP,), (".npz",), both=True),
    _Format("a workbook", WORKBOOK, (_ZIP, _OLE), _BOOKS, ("python_calamine", "xlsx"), both=True),
    _Format("HDF5", "hdf5", (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3"), (".h5", ".hdf5", ".hdf", ".nc", ".part")),
    _Format("MATLAB", "matlab", (b"MATLAB 5.0",), (".mat",)),
    _Format("JSON", "objects", (), (".json", ".jsonl", ".ndjson")),
)
"""What hil reads, besides text and bags."""

_FRAMES = (
    r"\A(LOGG|date \w+ \w+ \d+| ?\([\d.: -]+\) +\S+ +[\da-f]+(#| +\[)|"
    r"[^\n]*\b(dlc|can[ _]?id|arbitration[ _]?id)\b[^\n]*\bdata[^\n]*\n[^\n]*([\da-f]{2}[ ,]?){3})"
)
_PACKED = r"\A(PK\x03\x04|7z\xbc\xaf|Rar!|\x28\xb5\x2f\xfd|BZh|\xfd7zXZ)"
_ECHO = r"\A(---\n)?\w+:\s*\n +\w+:.*\n[\s\S]*^---$"
_LINES = r"\A(#[^\n]*\n)*[^\s,=]+(,[^\s,=]+=[^\s,]+)* [^\s,=]+=[-+\d.eE]+i?(,[^\s,=]+=\S+?)* \d{10,19}\s*$"
_NEVER = "loading it can run any program, so hil never does; save the table in it as CSV or Parquet"
_CONVERTED = (
    ("a WPILib log", r"\AWPILOG", (".wpilog",), "export it as CSV with AdvantageScope, File > Export Data"),
    ("an MDF file", r"\A(MDF  |UnFinMF)", (".mf4", ".mdf"), "convert it with asammdf: MDF(...).export('csv', 'log')"),
    ("a ULog of PX4", r"\AULog\x01", (".ulg", ".ulog"), "convert it with pyulog: ulog2csv FILE"),
    ("a log of ArduPilot", r"\A\xa3\x95\x80", (".tlog",), "convert it: mavlogdump.py --format csv FILE (pymavlink)"),
    ("a log of CAN frames", _FRAMES, (".blf", ".trc"), "decode it with the drive's DBC file, as cantools does"),
    ("a pickle of Python", r"\A\x80[\x02-\x05][\x95}\]c(q]", (".pkl", ".pickle", ".joblib"), _NEVER),
    ("a ROS 1 bag that was not closed", r"(?!)", (".bag.active",), "complete it: rosbag reindex FILE"),
    ("a pointer of Git LFS and not the file itself", r"\Aversion https://git-lfs", (), "fetch the file: git lfs pull"),
    ("a web page", r"\A\s*<(!doctype html|html)", (".html",), "save the table in it as CSV"),
    ("the output of ros2 topic echo", _ECHO, (), "record the topic, ros2 bag record TOPIC, and import the bag"),
    ("lines of Teleplot", r"\A\s*>[^\s:]+:[-+\d.]+[:;]", (), "print all numbers of one time in one line: 't:1,tau:2'"),
    ("InfluxDB's line protocol", _LINES, (), "query it as CSV, pivoted to a column for each field"),
    ("an archive", _PACKED, (".zip", ".tar", ".tgz", ".zst"), "unpack it, and import the file in it"),
)
"""What hil does not read: kind, pattern of its beginning (as Latin-1), ends of its name, and how to convert it."""


def kind_of(source: Path) -> str:
    """Return the module that reads a file, TEXT for text.

    Raises WrongUse if hil does not read it, with the way to convert it, or if a library is missing.
    """
    with open_input(source, largest=_LARGEST) as file:
        beginning, name = file.read(_BEGINNING), source.name.lower()
    fits = [(form, beginning.startswith(form.magic), name.endswith(form.suffixes)) for form in _READ]
    found = [form for form, magic, named in fits if magic and (named or not form.both)]
    for form in (found + [form for form, _, named in fits if named])[:1]:
        if form.needs is not None and find_spec(form.needs[0]) is None:
            raise WrongUse(f"{source} is {form.name}: pip install 'hil[{form.needs[1]}]', or save it as CSV")
        return form.reader
    for what, pattern, suffixes, how in _CONVERTED:
        if re.search(pattern, beginning.decode("latin-1"), re.IGNORECASE | re.MULTILINE) or name.endswith(suffixes):
            how_to = how.replace("FILE", quoted(source))
            raise WrongUse(f"{source} is {what}, which hil does not read: {how_to}")
    return TEXT


def columns(source: Path, kind: str) -> tuple[list[str], Callable[[Sequence[str]], list[Any]]]:
    """Return the headings of a file, and a function that reads some of its columns. kind: a module, or TEXT.

    Raises WrongUse for a file that is damaged, or too large when unpacked.
    """
    read: Callable[[Path], Columns] = import_module(f"hil.exchange.readers.{kind}").read
    return bounded(source, lambda: list(read(source))), partial(_values, source, read)


def _values(source: Path, read: Callable[[Path], Columns], names: Sequence[str]) -> list[Any]:
    def of_file() -> list[Any]:
        opened = read(source)
        return [opened[name]() for name in names]

    return bounded(source, of_file)
