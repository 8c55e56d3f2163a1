"""Turn a sheet of a workbook (.xlsx, .xlsm, .xlsb, .xls, .ods) into CSV with python-calamine."""

from __future__ import annotations

import csv
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import date, time, timedelta
from pathlib import Path
from typing import Any
from zipfile import ZipFile, is_zipfile

from hil.errors import WrongUse
from hil.exchange.headings import listed
from hil.recording.input import bounded

_NO_RESULT = re.compile(rb"(</f>|<f\b[^>]*/>)\s*(<v\s*/>|<v>\s*</v>)?\s*</c>")
_LATER = b'fullCalcOnLoad="1"'  # the program that wrote the workbook computed nothing, and stored 0 for each formula


@contextmanager
def as_csv(source: Path, sheet: str | None) -> Iterator[Path]:
    """Give a CSV file with the cells of a sheet, row for row. sheet: None for the only one that is not empty.

    Raises WrongUse, with the sheets that the workbook has; for formulas without results, and for merged numbers.
    """
    name, rows = bounded(source, lambda: _rows(source, sheet))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.csv"
        with path.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, delimiter="\t", quoting=csv.QUOTE_NONE, quotechar=None).writerows(rows)
        try:
            yield path
        except WrongUse as error:
            raise WrongUse(str(error).replace(str(path), f"{source}, sheet {name!r}")) from None


def _rows(source: Path, sheet: str | None) -> tuple[str, list[list[str]]]:
    from python_calamine import CalamineWorkbook

    _check_formulas(source)
    with CalamineWorkbook.from_path(source) as book:
        names = [sheet] if sheet is not None else [one for one in book.sheet_names if _height(book, one)]
        if len(names) != 1 or names[0] not in book.sheet_names:
            raise WrongUse(f"{source}: name the sheet with --topic; it has {listed(book.sheet_names)}")
        chosen = book.get_sheet_by_name(names[0])
        cells = chosen.to_python(skip_empty_area=False)
        for (top, left), (bottom, right) in chosen.merged_cell_ranges or ():
            _spread(source, cells, (top, left), (bottom, right))
    return names[0], [_line(row) for row in cells]


def _line(row: Sequence[Any]) -> list[str]:
    """Return a row as texts. A line of texts, such as a title, ends with its last text."""
    line = [_text(cell) for cell in row]
    while line and not line[-1] and all(isinstance(cell, str) for cell in row):
        line.pop()
    return line


def _height(book: Any, sheet: str) -> int:
    return int(book.get_sheet_by_name(sheet).height)


def _spread(source: Path, cells: Sequence[list[Any]], first: tuple[int, int], last: tuple[int, int]) -> None:
    """Write a heading in merged cells into each row of the cells. Raises WrongUse for a number, which was read once."""
    value = cells[first[0]][first[1]]
    if isinstance(value, int | float) and first[0] < last[0]:
        raise WrongUse(
            f"{source}: the number {value:g} stands in merged cells, rows {first[0] + 1} to {last[0] + 1}: it is not "
            "clear to which row it belongs: split these cells, and fill in what was read in each row"
        )
    for row in cells[first[0] : last[0] + 1]:
        row[first[1]] = value


def _check_formulas(source: Path) -> None:
    """Raise WrongUse if the results of formulas are not in the workbook: only programs that compute write them."""
    if not is_zipfile(source):
        return
    with ZipFile(source) as packed:
        later = any(_LATER in packed.read(name) for name in packed.namelist() if name == "xl/workbook.xml")
        sheets = [packed.read(name) for name in packed.namelist() if name.startswith("xl/worksheets/sheet")]
    if any(_NO_RESULT.search(text) or (later and b"<f" in text) for text in sheets):
        raise WrongUse(
            f"{source} has formulas without their results, because the program that wrote it computes nothing: open it "
            "in a spreadsheet program and save it there, or save the numbers as CSV"
        )


def _text(cell: Any) -> str:
    """Return a cell as CSV has it: dates as 2024-05-01 12:00:00."""
    if isinstance(cell, float | int):
        return repr(cell)
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    text = str(cell) if isinstance(cell, date | time) else " ".join(str(cell).split())
    return f'"{text.replace(chr(34), chr(39))}"' if re.search('[,;"]', text) else text
