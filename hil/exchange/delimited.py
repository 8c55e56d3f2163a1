"""Read CSV files of other programs: with any separator, byte-order marks and decimal commas; every error names its
row.
"""

from __future__ import annotations

import csv
import gzip
import math
import re
import zlib
from array import array
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from io import BufferedReader, TextIOWrapper
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange.headings import is_unit
from hil.exchange.readers.columns import seconds
from hil.exchange.row_filter import RowFilter
from hil.recording.input import open_input

if TYPE_CHECKING:
    from _csv import Reader

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_LARGEST = 1 << 36  # bytes of a file, which is read row by row
_LONGEST = 1 << 20  # characters of a line; what is longer is read as several, none of which has the right fields
_PREAMBLE = 200  # lines that are searched for the headings
_SHOWN = 40  # characters of a bad cell that are quoted
_EXAMPLE = ("time [s]", "torque [N*m]", "dtheta [rad]", "a", "b", "c", "d", "e")
_NO_UNIT = frozenset({"", "-", "1"})
_QUOTED = re.compile(r'"[^"]*"')
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")


def titles(source: Path) -> list[str]:
    """Return the headings of the table, in order. Raises WrongUse for a file that is no text."""
    with _text(source) as text:
        return _header(source, text).names


def read(source: Path, wanted: Sequence[int], filters: Sequence[tuple[int, RowFilter]]) -> tuple[Array, Rows]:
    """Return the columns `wanted` (indices) of the rows that pass every filter, (columns, n), and their line numbers
    (n,).

    In a row that does not pass, only the filtered cells are read. An empty cell is NaN. Raises WrongUse with the row
    that is wrong.
    """
    kept = [array("d") for _ in wanted]
    lines = array("q")
    with _text(source) as text:
        names, delimiter, height, dates, rest = _header(source, text)
        reader = _reader(rest, delimiter)
        cells = _Cells(source, names, dates)
        for row in _rows(source, reader, height):
            if not row:
                continue
            line = reader.line_num + height
            while len(row) > len(names) and not row[-1]:  # some loggers end every row with a delimiter
                row.pop()
            if len(row) != len(names):
                raise WrongUse(_unequal(source, line, row, names, delimiter))
            if all(
                one.keeps(row[at].strip() if isinstance(one.value, str) else cells.number(line, at, row[at]))
                for at, one in filters
            ):
                for column, at in zip(kept, wanted, strict=True):
                    column.append(cells.number(line, at, row[at]))
                lines.append(line)
        cells.check_commas()
    return np.array(kept, dtype=np.float64).reshape(len(kept), len(lines)), np.array(lines, dtype=np.int64)


def _rows(source: Path, reader: Iterator[list[str]], height: int) -> Iterator[list[str]]:
    try:
        yield from reader
    except csv.Error as error:
        line = getattr(reader, "line_num", 0) + height
        raise WrongUse(f"{source}, near row {line}: {_csv_error(error)}") from None


def _csv_error(error: csv.Error) -> str:
    if "field limit" in str(error):
        return (
            f"a field is longer than {csv.field_size_limit()} characters: close the quotation mark that was opened "
            "there, or check that the file is CSV"
        )
    return f"this is not CSV ({error})"


def _unequal(source: Path, line: int, row: list[str], names: list[str], delimiter: str) -> str:
    start = f"{source}, row {line}: {len(row)} fields, but the header names {len(names)}: "
    if delimiter == "," and len(row) > len(names):
        return start + "mend the row; where decimals are written with commas, separate the columns with semicolons"
    return start + "mend the row, or delete it if the file was cut off there"


class _Header(NamedTuple):
    """The head of a CSV file.

    names: headings. delimiter: between the cells. height: number of lines above the first row. dates: indices of
    columns with dates. rest: the lines below the head.
    """

    names: list[str]
    delimiter: str
    height: int
    dates: frozenset[int]
    rest: Iterator[str]


def _header(source: Path, text: TextIO) -> _Header:
    """Read the headings, and the line of units below them if there is one. Raises WrongUse for a table without
    headings.
    """
    top = [line for line in (text.readline(_LONGEST) for _ in range(_PREAMBLE)) if line]
    at, row = _place_of_headings(top)
    line = top[at].rstrip("\r\n") if top else ""
    delimiter = _delimiter(line)
    names = _split(source, line.removeprefix("#"), delimiter)  # numpy.savetxt writes a # before the headings
    if not row:
        _refuse_bare_numbers(source, top, len(names))
    below = iter(partial(text.readline, _LONGEST), "")
    names = names[: _widest(top[at + 1 :], delimiter) or None] if row else names
    height = next((place for place in range(at + 1, len(top)) if top[place].strip()), at + 1)
    if units := _units("".join(top[height : height + 1]), delimiter, len(names)):
        names = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
        height += 1
    dates = frozenset(place for place, cell in enumerate(row) if seconds(cell) is not None)
    names = [f"{name} [s]" if place in dates else name for place, name in enumerate(names)]
    return _Header(names, delimiter, height, dates, chain(top[height:], below))


def _refuse_bare_numbers(source: Path, top: Sequence[str], names: int) -> None:
    """Raise WrongUse for a table without headings: above its numbers there is nothing, or only comments or a title."""
    for line in top:
        delimiter = _delimiter(line)
        cells = _fields(line, delimiter)
        if any(cells) and all(_is_number(cell) for cell in cells if cell):
            if line is top[0] or top[0].startswith("#") or names == 1 < len(cells):
                raise WrongUse(
                    f"{source} has no headings: no names stand above its numbers. Write a line above them with the "
                    f"names and units of its {len(cells)} columns, such as {_example(len(cells), delimiter)!r}"
                )
            return


def _place_of_headings(top: Sequence[str]) -> tuple[int, list[str]]:
    """Return the index of the line of headings, and the cells of the first row below it ([] if no headings were
    recognised).

    Loggers write comments and settings above the headings. The headings are the first line without a number that has as
    many fields as the row of numbers below it. Empty lines or a line of units may stand in between. The very first line
    is used if no line satisfies this, or if the very first line has as many fields too and is no comment; then the row
    of numbers is reported as wrong.
    """
    for at in range(len(top)):
        delimiter = _delimiter(top[at])
        row = _next_row(top[at + 1 :], delimiter)
        if _heads(top[at].removeprefix("#"), delimiter, row):
            own = not top[0].startswith("#") and _heads(top[0], delimiter, row)
            return (0 if own else at), row
    return 0, []


def _heads(line: str, delimiter: str, row: Sequence[str]) -> bool:
    """Return whether a line can be the headings of a row: it has several names, no number, and a name for every
    non-empty cell.
    """
    names = _fields(line, delimiter)
    return len(row) > 1 < len(names) and not any(row[len(names) :]) and not any(map(_is_number, names))


def _widest(lines: Sequence[str], delimiter: str) -> int:
    """Return the largest number of fields in the lines. LabVIEW writes a heading "Comment" although the rows have no
    such cell.
    """
    return max((len(_fields(line, delimiter)) for line in lines), default=0)


def _next_row(lines: Sequence[str], delimiter: str) -> list[str]:
    """Return the cells of the first of the lines that is neither empty nor a line of units; [] if that line does not
    begin with a number.
    """
    for line in lines:
        cells = _fields(line, delimiter)
        if any(map(_is_number, cells)):
            return cells if _is_number(cells[0]) or seconds(cells[0]) is not None else []
        if any(cells) and not _units(line, delimiter, len(cells)):
            return []
    return []


def _example(columns: int, delimiter: str) -> str:
    names = _EXAMPLE[:columns]
    return delimiter.join(name.replace(" ", "") for name in names) if delimiter == " " else delimiter.join(names)


def _delimiter(line: str) -> str:
    """Return the delimiter between the fields of a line; a space if there is no other delimiter.

    A semicolon or tab between numbers is always the delimiter. Then the commas are decimal commas, however many there
    are.
    """
    for sure in ";\t":
        if sure in line and all(_is_number(cell) for cell in line.split(sure) if cell.strip()):
            return sure
    line = _QUOTED.sub("", line)
    found = max(",;\t", key=line.count)
    return found if found in line else " "


def _fields(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line, [] if it is not CSV."""
    try:
        return [cell.strip() for cell in next(_reader([line], delimiter), [])]
    except csv.Error:
        return []


def _reader(lines: Iterable[str], delimiter: str) -> Reader:
    """Return a reader of the rows in the lines; several spaces in sequence are one delimiter."""
    spaced = delimiter == " "
    ended = (line.rstrip() for line in lines) if spaced else lines
    return csv.reader(ended, delimiter=delimiter, skipinitialspace=spaced)


def _split(source: Path, line: str, delimiter: str) -> list[str]:
    try:
        return [name.strip() for name in next(_reader([line], delimiter), [])]
    except csv.Error as error:
        raise WrongUse(f"{source}, row 1: {_csv_error(error)}") from None


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _units(line: str, delimiter: str, columns: int) -> list[str]:
    """Return the units in the second line of a table, "" for a column without a unit; [] if the line is no line of
    units.

    A line with a quotation mark or a number is no line of units.
    """
    if '"' in line or any(map(_is_number, line.split(delimiter))):
        return []
    cells = [cell.strip("[](){}") for cell in _fields(line, delimiter)]
    stated = [cell for cell in cells if cell not in _NO_UNIT]
    if len(cells) != columns or not stated or not all(is_unit(cell) for cell in stated):
        return []
    return ["" if cell in _NO_UNIT else cell for cell in cells]


@contextmanager
def _text(source: Path) -> Iterator[TextIO]:
    try:
        with _bytes(source) as raw, TextIOWrapper(raw, encoding=_encoding(source), newline="") as text:
            yield text
    except UnicodeDecodeError:
        raise WrongUse(f"{source} cannot be read as text: save the table as CSV in UTF-8") from None
    except (gzip.BadGzipFile, EOFError, zlib.error):
        raise WrongUse(f"{source} cannot be read (it is no gzip file, or is cut off): check the name") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise WrongUse(f"{source} cannot be read ({reason}): check the name, and that it is CSV or .csv.gz") from None


@contextmanager
def _bytes(source: Path) -> Iterator[gzip.GzipFile | BufferedReader]:
    with open_input(source, largest=_LARGEST) as raw:
        if source.suffix.lower() == ".gz":
            with gzip.open(raw, "rb") as unpacked:
                yield unpacked
        else:
            yield raw


def _encoding(source: Path) -> str:
    """Return the encoding of a file: UTF-8 with or without a byte-order mark, or UTF-16, which spreadsheets call
    Unicode text.
    """
    with _bytes(source) as raw:
        return "utf-16" if raw.read(2) in {b"\xff\xfe", b"\xfe\xff"} else "utf-8-sig"


class _Cells:
    """Reads the numbers in cells, and determines whether the file uses decimal points or decimal commas.

    "1,234" may mean 1234 in one program and 1.234 in another. It is read as 1.234 if another number in the file, such
    as "0,5" or "12,25", can only have a decimal comma. A file without such a number is refused.
    """

    def __init__(self, source: Path, names: list[str], dates: frozenset[int]) -> None:
        self._source = source
        self._names = names
        self._dates = dates
        self._point = ""  # the place of the first number with a point, and with a comma
        self._comma = ""
        self._sure = False

    def number(self, line: int, at: int, cell: str) -> float:
        """Return the number in a cell; NaN for an empty cell. Identification drops rows with NaN and counts them."""
        text = cell.strip()
        if not text:
            return math.nan
        try:
            if "_" in text:
                raise ValueError  # only Python separates thousands so
            value = float(text)
        except ValueError:
            date = seconds(text) if at in self._dates else None
            return self._with_comma(line, at, text) if date is None else date
        if not self._point and "." in text:
            self._point = self._place(line, at, text)
        return value

    def _with_comma(self, line: int, at: int, text: str) -> float:
        if not _DECIMAL_COMMA.fullmatch(text):
            shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
            remedy = (
                "write dates as 2024-05-01 12:00:00.002, or the time in seconds"
                if ":" in text
                else "empty the cell where nothing was read"
            )
            raise WrongUse(f"{self._source}, row {line}, column {self._names[at]}: {shown!r} is not a number: {remedy}")
        if not self._comma:
            self._comma = self._place(line, at, text)
        self._sure = self._sure or not _THOUSANDS.fullmatch(text)
        return float(text.replace(",", "."))

    def _place(self, line: int, at: int, text: str) -> str:
        return f"{text!r} in row {line}, column {self._names[at]}"

    def check_commas(self) -> None:
        """Raise WrongUse if the file has decimal points and decimal commas, or if every comma may be a thousands
        separator.
        """
        if self._point and self._comma:
            raise WrongUse(
                f"{self._source} writes decimals both ways, {self._point}, and {self._comma}: write all with a point"
            )
        if self._comma and not self._sure:
            raise WrongUse(
                f"{self._source}: {self._comma}, may be a decimal or a thousand, like every number with a comma "
                "in the file: write decimals with a point"
            )
