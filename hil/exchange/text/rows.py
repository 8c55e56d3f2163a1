"""Read columns from a text table of another program, in any encoding, whole or cut off; every error names its row."""

from __future__ import annotations

import codecs
import csv
import gzip
import re
import zlib
from array import array
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from io import BufferedReader, StringIO, TextIOWrapper
from itertools import islice, product
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange.readers import formats, workbook
from hil.exchange.row_filter import RowFilter
from hil.exchange.text import plain
from hil.exchange.text.cells import Cells, NotANumber
from hil.exchange.text.layout import COMMENT, Layout, layout
from hil.recording.input import open_input

if TYPE_CHECKING:
    from _csv import Reader

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_TEXTS = 64  # at most in a column that names the rows
_LARGEST = 1 << 36  # bytes of a file, which is read row by row
_LONGEST = 1 << 20  # characters of a line; what is longer is read as several, none of which has the right fields
_BLOCK = 1 << 18  # characters that are parsed at a time
_PACKED = 10_000  # lines of a compressed file that are
_LOST = 0.01  # share of the rows that may be damaged: more mean that the table is not understood
_READING = re.compile(r"[-+.]?\d")  # the begin of a number, whole or not
_SNIFFED = 1 << 12  # bytes that show the encoding
_ENCODINGS = ("utf-8", "cp932", "gb18030", "cp949", "big5", "cp1251", "cp1250", "cp1253", "cp1254")
_KNOWN = "时间 扭矩 转矩 力矩 角度 時間 時刻 トルク 扭力 시간 토크 각도 время момент угол".split()  # noqa: SIM905 - in headings
_MOSTLY = 0.4  # share of every second byte that is 0 in UTF-16
_CONTROL = 0.1  # share of control characters from which a file is no text
_CONTROLS = bytes(set(range(32)) - set(b"\t\n\r\f\x1b"))


class Read(NamedTuple):
    """What was read of a table. numbers: columns (columns, n). places: line numbers (n,). lost: what was lost, as
    sentences.
    """

    numbers: Array
    places: Rows
    lost: list[str]


def form(source: Path, wanted: Collection[str] = (), sheet: str | None = None) -> Layout:
    """Return the layout of the table. wanted: names by which the line of headings is found. sheet: the name of the
    sheet, if the file is a workbook. Raises WrongUse for a file that is no text.
    """
    with _open(source, wanted, sheet, _Damage()) as lines:
        return layout(source, lines, wanted)


def labels(source: Path, form: Layout, asked: Collection[str], sheet: str | None) -> dict[str, set[str]]:
    """Return the texts in the columns that hold a few texts again and again, of all rows."""
    places = {name: form.names.index(name) for name in form.labels}
    found: dict[str, set[str]] = {name: {*texts} for name, texts in form.labels.items()}
    with _open(source, asked, sheet, _Damage()) as lines:
        _skip(lines, form.above)
        for row in _rows(source, form.reader(lines), form.above) if places else ():
            for name, at in places.items():
                if at < len(row) and len(found[name]) < _TEXTS:
                    found[name].add(row[at].strip())
    return found


def read(
    source: Path,
    form: Layout,
    asked: Collection[str],
    wanted: Sequence[int],
    filters: Sequence[tuple[int, RowFilter]],
    *,
    sheet: str | None = None,
    mark: str = ".",
) -> Read:
    """Return the columns `wanted` (indices) of the rows that pass every filter.

    form: the layout. asked, sheet: the arguments with which it was found. mark: the decimal mark if a number may have
    either. NumPy reads the blocks that hold nothing but numbers, and only the others are read cell by cell; in a row of
    these that does not pass, only the filtered cells are read. A missing reading is NaN. The last row may be cut off,
    and 1 % of the others damaged. Raises WrongUse with the row that is wrong.
    """
    parts, places, damage = [np.empty((len(wanted), 0))], [np.empty(0, dtype=np.int64)], _Damage()
    above = last = form.above
    needed = list(dict.fromkeys([*wanted, *(at for at, _ in filters)]))
    with _open(source, asked, sheet, damage) as lines:
        _skip(lines, form.above)
        is_plain = isinstance(lines, _Lines) and plain.is_possible(form, needed, filters)
        cells = Cells(form.names, form.clocks, mark)
        for block in lines.blocks() if is_plain and isinstance(lines, _Lines) else [lines]:
            if isinstance(block, str) and above == form.above and plain.has_commas(block, form, needed):
                cells = Cells(form.names, form.clocks, mark := ",")
            found = plain.numbers(block, form, mark) if isinstance(block, str) else None
            if isinstance(block, str) and found is not None:
                kept = np.ones(len(found), dtype=np.bool_)
                for at, one in filters:
                    kept &= one.keeps(found[:, at])
                parts.append((found if kept.all() else found[kept])[:, list(wanted)].T)
                places.append(np.flatnonzero(kept) + above + 1)
                above = last = above + len(found)
                cells.look_for_points(block)
                continue
            body = StringIO(block, newline="") if isinstance(block, str) else block
            reading = _Reading(source, form, cells, damage)
            read_cells, read_places = reading.rows(body, above, wanted, filters)
            parts.append(read_cells)
            places.append(read_places)
            above, last = reading.above, reading.last or last
        if (other := cells.other_mark(source)) is not None:
            return read(source, form, asked, wanted, filters, sheet=sheet, mark=other)
    rows = np.concatenate(places)
    return Read(np.concatenate(parts, axis=1), rows, damage.report(source, len(rows), last))


class _Reading:
    """Reads rows cell by cell. above: number of lines up to the last one that was read. last: that of the last row."""

    def __init__(self, source: Path, form: Layout, cells: Cells, damage: _Damage) -> None:
        self._source, self._form, self._cells, self._damage = source, form, cells, damage
        self.above = self.last = 0

    def rows(
        self, lines: Iterator[str], above: int, wanted: Sequence[int], filters: Sequence[tuple[int, RowFilter]]
    ) -> tuple[Array, Rows]:
        """Return the columns `wanted`, (columns, n), and the line numbers (n,) of the rows that pass every filter.

        above: number of lines above the first.
        """
        kept, places, cells = [array("d") for _ in wanted], array("q"), self._cells
        behind = max((*wanted, *(at for at, _ in filters)), default=0)
        reader = self._form.reader(_without_nul(lines, above, self._damage))
        for row in _rows(self._source, reader, above):
            if not row:
                continue
            self.last = last = reader.line_num + above
            try:
                _check_length(self._form, row, last, behind)
                if all(
                    one.keeps(row[at].strip() if isinstance(one.value, str) else cells.number(last, at, row[at]))
                    for at, one in filters
                ):
                    numbers = [cells.number(last, at, row[at]) for at in wanted]
                    places.append(last)
                    for column, number in zip(kept, numbers, strict=True):
                        column.append(number)
            except NotANumber as error:
                self._damage.note(self._source, last, str(error), self._form, row)
        self.above = reader.line_num + above
        table = np.array(kept, dtype=np.float64).reshape(len(kept), len(places))
        return table, np.array(places, dtype=np.int64)


def _skip(lines: Iterator[str], count: int) -> None:
    next(islice(lines, count, count), None)


def _check_length(form: Layout, row: list[str], line: int, last: int) -> None:
    """Raise NotANumber if a row has not one cell for each heading. last: index of the last column that is read; columns
    behind it may be missing in all rows.
    """
    while len(row) > len(form.names) and not row[-1].strip():  # some loggers end every row with a delimiter
        row.pop()
    if len(row) == len(form.names) or (len(row) == form.fields < len(form.names) and last < len(row)):
        return
    remedy = "mend the row, or delete it if the file was cut off there"
    if form.delimiter == "," and len(row) > len(form.names):
        remedy = (
            "mend the row; where decimals or thousands are written with commas, separate the columns with semicolons"
        )
    raise NotANumber(f"row {line}: {len(row)} fields, but the header names {len(form.names)}: {remedy}")


class _Damage:
    """Counts the lines of a table that are no rows of numbers. cut_off: whether a compressed file lacks its end.

    Headings and texts that a logger writes at each start are not counted, because they hold no reading.
    """

    def __init__(self) -> None:
        self.lost: list[tuple[int, str]] = []
        self.cut_off = False

    def note(self, source: Path, line: int, what: str, form: Layout, row: list[str]) -> None:
        """Count a damaged line, unless it holds no reading. what: the damage in words. Raises WrongUse for headings in
        another order.
        """
        cells = tuple(cell.strip().lstrip("\ufeff") for cell in row)
        if cells not in form.heads and any(len({*cells} & {*head} - {""}) > 1 for head in form.heads):
            raise WrongUse(
                f"{source}, row {line}: the headings stand there again, with other columns or in another order: write "
                "each part into a separate file"
            )
        if cells not in form.heads and not COMMENT.match(row[0]) and any(map(_READING.match, cells)):
            self.lost.append((line, what))

    def report(self, source: Path, kept: int, last: int) -> list[str]:
        """Return sentences about the lost rows. kept: number of rows that were read. last: number of the last line.

        Raises WrongUse if more than 1 % are lost.
        """
        count = kept + len(self.lost)
        before = [one for one in self.lost if one[0] < last]
        if len(before) > _LOST * count or (self.lost and not kept):
            raise WrongUse(f"{source}, {self.lost[0][1]}")
        said = []
        if self.lost:
            rows = "1 row is" if len(self.lost) == 1 else f"{len(self.lost)} of {count} rows are"
            said.append(f"{rows} damaged and left out; the first is {self.lost[0][1].partition(': mend')[0]}")
        if self.cut_off:
            said.append(f"the file is cut off after row {last}, and what followed is lost")
        return said


def _rows(source: Path, reader: Reader, above: int) -> Iterator[list[str]]:
    try:
        yield from reader
    except csv.Error as error:
        what = f"this is not CSV ({error})"
        if "field limit" in str(error):
            what = (
                f"a field is longer than {csv.field_size_limit()} characters: close the quotation mark that was opened "
                "there, or check that the file is CSV"
            )
        raise WrongUse(f"{source}, near row {reader.line_num + above}: {what}") from None


def _without_nul(lines: Iterator[str], above: int, damage: _Damage) -> Iterator[str]:
    """Yield the lines. A line with NUL bytes, which a loss of power leaves in a file, becomes an empty line and is
    counted in `damage`. above: number of lines above the first.
    """
    for at, line in enumerate(lines, above + 1):
        if "\0" in line:
            damage.lost.append((at, f"row {at}: NUL bytes, as a disk has after a loss of power"))
        yield "\n" if "\0" in line else line


@contextmanager
def _open(
    source: Path, wanted: Collection[str], sheet: str | None, damage: _Damage
) -> Iterator[Iterator[str] | _Lines]:
    """Yield an iterator over the lines of a text, or of a sheet of a workbook."""
    if formats.kind_of(source) == formats.WORKBOOK:
        yield iter(workbook.lines(source, sheet))
        return
    try:
        with _bytes(source) as raw, TextIOWrapper(raw, _encoding(source, wanted), "replace", newline="") as text:
            yield _Lines(text, damage, is_packed=source.suffix.lower() == ".gz")
    except (gzip.BadGzipFile, EOFError, zlib.error):
        raise WrongUse(f"{source} cannot be read (it is no gzip file, or is damaged): check the name") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise WrongUse(f"{source} cannot be read ({reason}): check the name, and that it is CSV or .csv.gz") from None


class _Lines:
    """The lines of a text. If a compressed file ends before its end mark, they end there, and `damage` says so."""

    def __init__(self, text: TextIO, damage: _Damage, *, is_packed: bool) -> None:
        self._text, self._damage, self._is_packed, self._is_begun = text, damage, is_packed, False

    def __iter__(self) -> _Lines:
        return self

    def __next__(self) -> str:
        try:
            line = self._text.readline(_LONGEST)
        except EOFError:
            line = self._ended()
        if not line:
            raise StopIteration
        self._is_begun = True
        return line

    def blocks(self) -> Iterator[str]:
        """Yield whole lines in blocks, without a line break in quotation marks at their ends."""
        while text := self._block():
            while text.count('"') % 2 and len(text) < _LONGEST and (more := next(self, "")):
                text += more
            yield text

    def _block(self) -> str:
        if self._is_packed:  # what is cut off ends within a block
            return "".join(islice(self, _PACKED))
        return self._text.read(_BLOCK) + self._text.readline(_LONGEST)

    def _ended(self) -> str:
        if not self._is_begun:
            raise EOFError
        self._damage.cut_off = True
        return ""


@contextmanager
def _bytes(source: Path) -> Iterator[gzip.GzipFile | BufferedReader]:
    with open_input(source, largest=_LARGEST) as raw:
        if source.suffix.lower() == ".gz":
            with gzip.open(raw, "rb") as unpacked:
                yield unpacked
        else:
            yield raw


def _holds(start: bytes, word: str, encoding: str) -> bool:
    with suppress(UnicodeEncodeError):
        return word.encode(encoding) in start
    return False


def _encoding(source: Path, wanted: Collection[str]) -> str:
    """Return the encoding of a file: UTF-16, which spreadsheets call Unicode text; one in which the file contains the
    wanted names; UTF-8 with or without a byte-order mark; one in which it has a word of headings; else that of Windows.
    Raises WrongUse for a file that is no text.
    """
    start = b""
    with _bytes(source) as raw, suppress(EOFError):  # a packed file that is cut off has no beginning
        start = raw.read(_SNIFFED)
    if start[:2] in {b"\xff\xfe", b"\xfe\xff"}:
        return "utf-16"
    for first, name in ((0, "utf-16-be"), (1, "utf-16-le")):
        if start[first::2].count(0) > _MOSTLY * len(start[first::2]) and not start[1 - first :: 2].count(0):
            return name
    if len(start.translate(None, _CONTROLS)) < (1.0 - _CONTROL) * len(start.replace(b"\0", b"")):
        raise WrongUse(f"{source} is no text: save the table as CSV in UTF-8")
    names = [name for name in wanted if not name.isascii()]
    for one in _ENCODINGS if names else ():
        with suppress(UnicodeEncodeError):
            if all(name.encode(one) in start for name in names):
                return one
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return next((one for one, word in product(_ENCODINGS[1:], _KNOWN) if _holds(start, word, one)), "cp1252")
    return "utf-8-sig"
