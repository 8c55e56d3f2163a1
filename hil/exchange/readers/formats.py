"""The table of formats: how each file is recognised, and which module reads it or which program converts it."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hil.errors import WrongUse
from hil.exchange.readers import workbook
from hil.exchange.readers.columns import Columns
from hil.recording.input import bounded, open_input

_LARGEST = 1 << 36  # bytes of a file
_BEGINNING = 1 << 12  # bytes of a file in which its kind is looked for
_ZIP, _HDF5, _OLE = b"PK\x03\x04", b"\x89HDF\r\n\x1a\n", b"\xd0\xcf\x11\xe0"
_WORKBOOK = "workbook"
_BOOKS = (".xlsx", ".xlsm", ".xlsb", ".ods")


@dataclass(frozen=True, slots=True)
class _Format:
    """A kind of file.

    magic: bytes at the beginning of each file of the kind. suffixes: of their names, in small letters. both: whether
    the magic alone is not enough. reader: module of this folder. needs: package and extra of hil that it needs, if hil
    does not depend on it.
    """

    name: str
    magic: tuple[bytes, ...]
    suffixes: tuple[str, ...]
    reader: str
    needs: tuple[str, str] | None = None
    both: bool = False

    def fits(self, beginning: bytes, name: str) -> tuple[bool, bool]:
        """Return whether the magic is that of this format, and whether the name's end is."""
        return beginning.startswith(self.magic), name.lower().endswith(self.suffixes)


_READ = (
    _Format(
        "Parquet or Arrow",
        (b"PAR1", b"ARROW1"),
        (".parquet", ".pq", ".feather", ".arrow"),
        "arrow",
        ("pyarrow", "parquet"),
    ),
    _Format("TDMS", (b"TDSm",), (".tdms",), "tdms", ("nptdms", "tdms")),
    _Format("NumPy", (b"\x93NUMPY",), (".npy", ".npz"), "arrays"),
    _Format("NumPy", (_ZIP,), (".npz",), "arrays", both=True),
    _Format("a workbook", (_ZIP, _OLE), (*_BOOKS, ".xls"), _WORKBOOK, ("python_calamine", "xlsx"), both=True),
    _Format("HDF5", (_HDF5, b"MATLAB 7.3"), (".h5", ".hdf5", ".hdf", ".nc", ".part"), "hdf5"),
    _Format("MATLAB", (b"MATLAB 5.0",), (".mat",), "matlab"),
    _Format("JSON", (), (".json", ".jsonl", ".ndjson"), "objects"),
)
"""What hil reads, besides text and bags."""

_LABELLED = r"(?:[\d:.]+ -> )?(?:[a-z_]\w* ?[:=] ?[-+]?\d[\d.e+-]*(?: ?[a-z/*]+)?(?:[,;\t ]+|\r?\n)){2,}"
_CONVERTED = (
    ("a WPILib log", r"\AWPILOG", (".wpilog",), "export it as CSV with AdvantageScope, File > Export Data"),
    (
        "an MDF file",
        r"\A(MDF  |UnFinMF)",
        (".mf4", ".mdf"),
        "convert it with asammdf: MDF(...).export('csv', 'log')",
    ),
    ("a ULog of PX4", r"\AULog\x01", (".ulg", ".ulog"), "convert it with pyulog: ulog2csv FILE"),
    ("a log of ArduPilot", r"\A\xa3\x95\x80", (".tlog",), "convert it with pymavlink: mavlogdump.py --format csv FILE"),
    (
        "a log of CAN frames",
        r"\A(LOGG|date \w+ \w+ \d+| ?\(\d+\.\d+\) +\S+ +[\da-f]+(#| +\[))",
        (".blf", ".trc"),
        "decode its frames with the DBC file of the drive, for example with asammdf or cantools",
    ),
    (
        "a pickle of Python",
        r"\A\x80[\x02-\x05][\x95}\]c(q]",
        (".pkl", ".pickle", ".joblib"),
        "loading it can run any program, so hil never does; save the table in it as CSV or Parquet",
    ),
    ("a ROS 1 bag that was not closed", r"(?!)", (".bag.active",), "complete it: rosbag reindex FILE"),
    ("a pointer of Git LFS and not the file itself", r"\Aversion https://git-lfs", (), "fetch the file: git lfs pull"),
    ("a web page", r"\A\s*<(!doctype html|html)", (".html",), "save the table in it as CSV"),
    (
        "the text of a serial monitor, with a label beside each number",
        rf"(?m)^{_LABELLED}{_LABELLED}",
        (),
        "remove the labels, sed -E 's/^.* -> //; s/[A-Za-z_]+ ?[:=] ?//g' FILE > log.csv, and write a line with the "
        "names and units of the columns above the numbers",
    ),
    (
        "an archive",
        r"\A(PK\x03\x04|7z\xbc\xaf|Rar!|\x28\xb5\x2f\xfd|BZh|\xfd7zXZ)",
        (".zip", ".tar", ".tgz", ".zst"),
        "unpack it, and import the file in it",
    ),
)
"""What hil does not read: kind, pattern of its beginning (as Latin-1), ends of its name, and how to convert it."""


def columns(
    source: Path, topic: str | None, joint: str | None
) -> tuple[list[str], Callable[[Sequence[str]], list[Any]]] | None:
    """Return the headings of a file and a function that reads some of its columns; None for text and workbooks.

    topic, joint: as a bag has them. Raises WrongUse for a file that has to be converted, with the way to do so, for one
    that is damaged or unpacks to too much, and for one that has no topics.
    """
    form = _format(source)
    if form is None or form.reader == _WORKBOOK:
        return None
    if joint is not None or topic is not None:
        raise WrongUse(f"{source} is {form.name}, which has no topics or joints: name its columns")
    read: Callable[[Path], Columns] = import_module(f"hil.exchange.readers.{form.reader}").read
    return bounded(source, lambda: list(read(source))), partial(_values, source, read)


def as_text(source: Path, sheet: str | None) -> AbstractContextManager[Path]:
    """Give the path of the same table as text: of the file itself, or of a copy of the sheet of a workbook as CSV."""
    form = _format(source)
    return nullcontext(source) if form is None else workbook.as_csv(source, sheet)


def _values(source: Path, read: Callable[[Path], Columns], names: Sequence[str]) -> list[Any]:
    def of_file() -> list[Any]:
        opened = read(source)
        return [opened[name]() for name in names]

    return bounded(source, of_file)


def _format(source: Path) -> _Format | None:
    """Return the format of a file, None for text. Raises WrongUse if hil does not read it, or lacks a library."""
    with open_input(source, largest=_LARGEST) as file:
        beginning = file.read(_BEGINNING)
    fits = [(form, *form.fits(beginning, source.name)) for form in _READ]
    found = [form for form, magic, named in fits if magic and (named or not form.both)]
    found += [form for form, _, named in fits if named]
    for form in found[:1]:
        if form.needs is not None and find_spec(form.needs[0]) is None:
            raise WrongUse(f"{source} is {form.name}: pip install 'hil[{form.needs[1]}]', or save it as CSV")
        return form
    for what, pattern, suffixes, how in _CONVERTED:
        if re.search(pattern, beginning.decode("latin-1"), re.IGNORECASE) or source.name.lower().endswith(suffixes):
            how_to = how.replace("FILE", shlex.quote(str(source)))
            raise WrongUse(f"{source} is {what}, which hil does not read: {how_to}")
    return None
