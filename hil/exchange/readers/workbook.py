"""Read a sheet of a workbook (.xlsx, .xlsm, .xlsb, .xls, .ods) as lines of text with python-calamine."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date, time, timedelta
from pathlib import Path
from typing import Any
from zipfile import ZipFile, is_zipfile

from hil.errors import WrongUse
from hil.exchange.headings import listed
from hil.recording.input import bounded

_NO_RESULT = re.compile(rb"(</f>|<f\b[^>]*/>)\s*(<v\s*/>|<v>\s*</v>)?\s*</c>")
_LATER = b'fullCalcOnLoad="1"'  # the program that wrote the workbook computed nothing, and stored 0 for each formula


def lines(source: Path, sheet: str | None) -> list[str]:
    """Return the rows of a sheet as lines of cells between tabs. sheet: None for the only one that is not empty.

    Raises WrongUse, with the sheets that the workbook has; for formulas without results, and for merged numbers.
    """
    return bounded(source, lambda: _lines(source, sheet))


def _lines(source: Path, sheet: str | None) -> list[str]:
    from python_calamine import CalamineWorkbook

    _check_formulas(source)
    with CalamineWorkbook.from_path(source) as book:
        filled = [one for one in book.sheet_names if int(book.get_sheet_by_name(one).height)]
        names = filled if sheet is None else [sheet]
        if len(names) != 1 or names[0] not in book.sheet_names:
            raise WrongUse(f"{source}: name the sheet with --topic; it has {listed(book.sheet_names)}")
        chosen = book.get_sheet_by_name(names[0])
        cells = chosen.to_python(skip_empty_area=False)
        for (top, left), (bottom, _) in chosen.merged_cell_ranges or ():
            value = cells[top][left]
            if isinstance(value, int | float) and top < bottom:
                raise WrongUse(
                    f"{source}: the number {value:g} stands in merged cells, rows {top + 1} to {bottom + 1}: it is not "
                    "clear to which row it belongs: split these cells, and fill in what was read in each row"
                )
            for row in cells[top : bottom + 1]:
                row[left] = value
    return [_line(row) for row in cells]


def _line(row: Sequence[Any]) -> str:
    """Return a row as text. A line of texts, such as a title, ends with its last text."""
    texts = [_text(cell) for cell in row]
    while texts and not texts[-1] and all(isinstance(cell, str) for cell in row):
        texts.pop()
    return "\t".join(texts) + "\n"


def _check_formulas(source: Path) -> None:
    """Raise WrongUse if the workbook lacks the results of its formulas: only programs that compute formulas
    write them.
    """
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
