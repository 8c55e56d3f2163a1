"""Find the headings, the units and the first row of a text table, below whatever its writer put above them."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hil.errors import WrongUse
from hil.exchange import headings
from hil.exchange.text.cells import LISTS, clock, is_missing, is_number
from hil.exchange.text.monitor import Monitor, monitor

if TYPE_CHECKING:
    from _csv import Reader

_TOP = 1000  # lines that are searched for the headings
_PREAMBLE = 3  # lines at least of one beside the rows
_HEADING = 10  # lines that quoted headings may take
_DELIMITERS = (";", "\t", "|", ",", " ")
_EXAMPLE = ("time [s]", "torque [N*m]", "dtheta [rad]", "a", "b", "c", "d", "e")
COMMENT = re.compile(r"^\s*(?:#+|%+|//+|!+)\s*")
_UNITS = re.compile(
    r"[\W_]*(?:\w+_|[hvxy])?(?:units?|einheit(?:en)?|unités?|unidad(?:es)?)(?:_label)?\b\"? *:?", re.IGNORECASE
)
_LABEL = re.compile(r"signals?|channels?|(?:trace|channel|signal)?[ _]?names?", re.IGNORECASE)  # of the headings
_OF_TIME = re.compile(r"[\W_]*[hx][a-z]*[_ ]?unit", re.IGNORECASE)  # of the horizontal axis of an oscilloscope
_NO_UNIT = frozenset({"", "-", "--", "1", "n/a"})
_OTHER_UNITS = frozenset("% counts count cnt ticks lsb raw bits N kN mN lbf kgf Pa kPa MPa GPa bar W J".split())  # noqa: SIM905
_DATE = re.compile(r"\d{4}([-/.])\d\d?\1\d\d?|\d\d?([-/.])\d\d?\2\d{4}")
_OF_DATE = re.compile("da[ty]|time|stamp|clock|zeit|tag|fecha|[^ -~]", re.IGNORECASE)
_USUAL = 0.8  # share of the rows that have a number in a column


class Layout(NamedTuple):
    """The layout of a text table.

    names: headings. delimiter: between the cells. above: number of lines above the first row. fields: usual number of
    cells in a row. clocks: indices of columns with dates or times of day. heads: cells of the lines that stand above
    the rows, and may stand between them again. monitor: what a serial monitor wrote into each line. top: the lines
    above the rows. labels: the texts in columns that hold a few texts again and again.
    """

    names: list[str]
    delimiter: str
    above: int
    fields: int
    clocks: frozenset[int]
    heads: frozenset[tuple[str, ...]]
    monitor: Monitor
    top: tuple[str, ...]
    labels: Mapping[str, frozenset[str]]

    def reader(self, lines: Iterable[str]) -> Reader:
        """Return the rows in the lines, with the stamp of a serial monitor as the first cell."""
        return _reader(self.monitor.plain(lines, self.delimiter) if any(self.monitor) else lines, self.delimiter)


def layout(source: Path, lines: Iterator[str], wanted: Collection[str]) -> Layout:
    """Return the layout of the table in the lines.

    wanted: names of columns, which the line of headings must contain. Raises WrongUse for a table without headings, or
    without rows.
    """
    top = _whole(list(islice(lines, _TOP)))
    longest = csv.field_size_limit()
    if any(len(line) > longest for line in top[:1]):
        raise WrongUse(f"{source}, row 1: a field is longer than {longest} characters: check that the file is CSV")
    shown, plain, said = monitor(top)
    if shown.labels:
        plain = list(Monitor(stamped=False, labels=shown.labels).plain(plain, ","))
    delimiter, fields, rows = _rows(plain)
    if not rows:
        _refuse_lists(source, plain)
        raise WrongUse(
            f"{source} has no rows: none of its lines has two cells that are numbers: write units in the headings "
            "only, and numbers in the cells"
        )
    if shown.labels:
        first, names, at = rows[0], [_with_unit(one, said.get(one, "")) for one in shown.labels], rows[0]
    elif beside := _beside(plain, delimiter, fields):
        first, names, at = 0, beside, 0
    else:
        first, names, at = _headings(source, plain, (delimiter, fields, rows), wanted)
        names = _with_group(plain[:at], delimiter, names)
        beneath = [line for line in plain[at + 1 : first] if line.strip() and not _UNITS.match(line)]
        below = [split_line(COMMENT.sub("", line), delimiter) for line in beneath]
        labelled = [
            _unlabelled(line, delimiter, len(names))
            for line in plain[:first]
            if _UNITS.match(line) and not _OF_TIME.match(line)
        ]
        for cells in (*below, *labelled):
            if delimiter == " " and len(cells) != len(names):  # a missing unit would shift those behind it
                continue
            names = [_with_unit(name, unit) for name, unit in zip(names, _units(cells, len(names)), strict=True)]
    heads = frozenset(tuple(split_line(line, delimiter)) for line in plain[at:first] if line.strip())
    row = split_line(next(shown.plain([top[first]], delimiter)), delimiter)
    if shown.stamped:
        names, fields = ["received", *names], fields + 1
    if delimiter == " ":
        _refuse_shifted(source, names, row)
    texts = {} if shown.stamped else _labels(names, [split_line(plain[place], delimiter) for place in rows])
    clocks = frozenset(place for place, cell in enumerate(row[: len(names)]) if clock(cell) is not None)
    names = [f"{name} [s]" if place in clocks else name for place, name in enumerate(names)]
    return Layout(names, delimiter, first, fields, clocks, heads, shown, tuple(plain[:first]), texts)


def _refuse_shifted(source: Path, names: Sequence[str], row: Sequence[str]) -> None:
    for name, cell in zip(names, row, strict=False):
        if _DATE.fullmatch(cell) and not _OF_DATE.search(name):
            raise WrongUse(
                f"{source}: the date {cell} stands under the heading {name!r}, so spaces within headings or cells "
                "shift the columns: separate the columns by tabs or commas"
            )


def _refuse_lists(source: Path, lines: Sequence[str]) -> None:
    found = [match[0] for match in map(LISTS.search, lines) if match]
    if len(found) > _USUAL * len(lines):
        raise WrongUse(
            f"{source} holds lists in its cells, such as {found[0]}, whose order no heading names: write each number "
            "of a list into a column, with a heading such as q0 [rad]"
        )


def _whole(lines: list[str]) -> list[str]:
    """Return the lines. Headings that contain a quoted line break are joined in the line where they end."""
    for at in range(len(lines) - 1):
        if lines[at].count('"') % 2 == 0:
            continue
        quotes = np.cumsum([line.count('"') for line in lines[at : at + _HEADING]])
        if (ends := np.flatnonzero(quotes % 2 == 0)).size:
            parts = lines[at : at + int(ends[0]) + 1]
            lines[at : at + len(parts)] = ["\n"] * (len(parts) - 1) + [" ".join(map(str.strip, parts))]
    return lines


def _rows(lines: Sequence[str]) -> tuple[str, int, list[int]]:
    """Return delimiter and number of cells of the rows of numbers, and the indices of these rows; [] without rows.

    The rows are the lines that have the most frequent number of cells, and numbers in the columns where most have one.
    """
    best = [max((_numeric(line, one), -at, one) for at, one in enumerate(_DELIMITERS)) for line in lines]
    shapes = [
        (one, len(split_line(line, one))) if n > 1 else None for line, (n, _, one) in zip(lines, best, strict=True)
    ]
    counts = Counter(one for one in shapes if one)
    if not counts:
        return "", 0, []
    shape = max(counts, key=lambda one: (counts[one], len(shapes) - shapes[::-1].index(one)))  # of equals the last
    rows = [  # of the others, a cell may look like two: "0,1 2,5"
        at
        for at, line in enumerate(lines)
        if len(split_line(line, shape[0])) == shape[1] and _numeric(line, shape[0]) > 1
    ]
    filled = np.array(
        [[_is_reading(cell) or is_missing(cell) for cell in split_line(lines[at], shape[0])] for at in rows]
    )
    usual = filled.mean(axis=0) >= _USUAL
    return *shape, [at for at, row in zip(rows, filled, strict=True) if row[usual].all()]


def _labels(names: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[str, frozenset[str]]:
    found = {}
    for at, name in enumerate(names):
        texts = [row[at] for row in rows if at < len(row)]
        if len(set(texts)) <= len(texts) // 2 and not any(map(_is_reading, set(texts))) and any(texts):
            found[name] = frozenset(texts)
    return found


def _beside(lines: Sequence[str], delimiter: str, fields: int) -> list[str]:
    """Return the names of the columns where the preamble of an oscilloscope stands beside the first rows; [] elsewhere.

    The first column of numbers is the time; the others have the name of the source, and then its next numbers.
    """
    cells = [split_line(line, delimiter) for line in lines[:_TOP] if line.strip()]
    if delimiter == " " or len(cells) < _PREAMBLE or any(len(row) != fields for row in cells):
        return []
    full = [all(is_number(row[at]) for row in cells) for at in range(fields)]
    first = full.index(True) if True in full else fields
    said = {" ".join(row[:1]).lower(): row[1:first] for row in cells[:_HEADING] if row[0] and not is_number(row[0])}
    if not 1 < first < fields - 1 or len(said) < _PREAMBLE or any(row[0] for row in cells[-_PREAMBLE:]):
        return []
    stated = {key: next(filter(None, values), "") for key, values in said.items()}
    source = re.fullmatch(r"(.*?)(\d*)", stated.get("source") or "CH1")
    start = int(source[2] or 1) if source else 1
    channels = [f"{source[1] if source else 'CH'}{start + at}" for at in range(fields - first - 1)]
    time = _with_unit("time", stated.get("horizontal units", ""))
    read = [time, *(_with_unit(one, stated.get("vertical units", "")) for one in channels)]
    return [f"preamble {at}" for at in range(first)] + [
        one if ok else "" for one, ok in zip(read, full[first:], strict=True)
    ]


def _with_group(above: Sequence[str], delimiter: str, names: list[str]) -> list[str]:
    """Return names that repeat with the cells of the line above them, each of which stands for the empty ones after it:
    "Motor" above "angle" gives "Motor angle". A column without a name has that of the line above.
    """
    cells = split_line(COMMENT.sub("", next((line for line in reversed(above) if line.strip()), "")), delimiter)
    if len(cells) == len(names) and _are_names(cells):
        names = [name or cell for name, cell in zip(names, cells, strict=True)]
    filled = [name for name in names if name]
    if len(set(filled)) == len(filled) or not 1 < len(cells) <= len(names) or any(map(is_number, cells)):
        return names
    groups = [""]
    for cell in cells + [""] * (len(names) - len(cells)):
        groups.append(cell or groups[-1])
    joined = [f"{group} {name}".strip() for group, name in zip(groups[1:], names, strict=True)]
    return joined if len(set(joined)) == len(joined) else names


def _is_reading(cell: str) -> bool:
    return is_number(cell) or clock(cell) is not None


def _numeric(line: str, delimiter: str) -> int:
    return sum(map(_is_reading, split_line(line, delimiter))) if delimiter in line else 0


def _headings(
    source: Path, lines: Sequence[str], shape: tuple[str, int, list[int]], wanted: Collection[str]
) -> tuple[int, list[str], int]:
    """Return the index of the first row, the headings of its cells, and the index of their line. shape: from `_rows`.

    The line of headings has all wanted names. Without such a line, it is the nearest line above the rows, and above the
    units, that has a name for each cell. Where a log began in the middle of a row, the headings follow the first rows.
    """
    delimiter, fields, rows = shape
    numbers = set(rows)
    texts = [at for at, line in enumerate(lines) if line.strip() and at not in numbers]
    nearest = [at for at in reversed(texts) if at < rows[0]] + [at for at in texts if at > rows[0]]
    choices = []
    for at in nearest:
        is_above = at < rows[0] and not COMMENT.match(lines[at])
        for names, fits, mark in _splits(lines[at], delimiter, fields):
            has = bool(wanted) and (fits or mark.strip(" ") != "") and _has(names, wanted)
            if has or fits or (is_above and len(names) > 1):
                is_units = any(_units(names, len(names)))
                choices.append((has, fits, is_units, at, names))
    beneath = [at for _, fits, is_units, at, names in choices if fits and is_units and headings.is_unit(names[0])]
    units = max((at for at in beneath if at < rows[0]), default=len(lines))
    has, fits, _, at, names = min(
        choices,
        key=lambda one: (not one[0], not one[1], one[2], one[3] > units, any(map(is_number, one[4]))),
        default=(False, False, False, len(lines), []),
    )
    if delimiter == " " and not fits and len(names) > fields:
        raise WrongUse(
            f"{source}: {len(names)} words stand above rows of {fields} cells, so spaces within headings shift the "
            f"columns: write _ for them, or separate the columns by tabs or commas"
        )
    names = _without_label(lines[: rows[0]], delimiter, names, fields)
    first = next((row for row in rows if row > at), None)
    if first is None:
        raise WrongUse(
            f"{source} has no headings: no names stand above its numbers. Write a line above them with the "
            f"names and units of its {fields} columns, such as {_example(fields, delimiter)!r}"
        )
    return first, names[:fields] if fits else names, at


def _without_label(lines: Sequence[str], delimiter: str, names: list[str], fields: int) -> list[str]:
    """Return the names without the label in front of them that the line of units has too."""
    beside = [len(split_line(line.rstrip(), delimiter)) for line in lines if _UNITS.match(line)]
    is_label = len(names) == fields + 1 and len(names) in beside and _LABEL.fullmatch(names[0])
    return names[1:] if is_label else names


def _splits(line: str, delimiter: str, fields: int = 0) -> Iterator[tuple[list[str], bool, str]]:
    """Yield each way to split a line into names: the names, whether there are `fields` names,
    and the delimiter.

    Names beyond `fields` are dropped, because some loggers name a column "Comment" and do not fill it. A line with more
    words, separated by spaces, than `fields` is no line of names.
    """
    without = COMMENT.sub("", line)
    for text in dict.fromkeys((without, line)):
        for one in dict.fromkeys((delimiter or max(_DELIMITERS, key=text.count), *_DELIMITERS)):
            for names in _names(text, one):
                filled = len(names) - next((at for at, name in enumerate(reversed(names)) if name), len(names))
                if filled and _are_names(names) and (one in text.strip() or not delimiter):
                    extra = one not in {" ", ""} and one == delimiter and filled > fields
                    yield names, len(names) == fields or filled == fields or extra, one


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether no cell is a number, except for those of channels, such as 1 and 2, beside a name; nor a time."""
    if any(clock(cell) is not None or _DATE.fullmatch(cell) for cell in cells):
        return False
    numbers = [cell for cell in cells if is_number(cell)]
    are_channels = len(set(numbers)) == len(numbers) and all(re.fullmatch(r"\d{1,2}", cell) for cell in numbers)
    return not numbers or (are_channels and any(cell and not is_number(cell) for cell in cells))


def _names(text: str, delimiter: str) -> Iterator[list[str]]:
    yield [" ".join(name.split()) for name in split_line(text, delimiter)]
    if delimiter == " ":  # "Time (s)  Torque (N m)"
        yield [name.strip() for name in re.split(r"\s{2,}", text.strip())]
        yield re.findall(r"[^\s([]+(?:\s*[([][^\])]*[\])])?", text)


def _has(names: Sequence[str], wanted: Collection[str]) -> bool:
    known = set(names).union(*map(headings.names, names))
    return all(name in known for name in wanted)


def _units(cells: Sequence[str], columns: int) -> list[str]:
    """Return the units in a line between headings and rows, "" for a column without a unit; all "" if the line is no
    line of units.

    In a line of units, most cells are units or in brackets. A unit that hil does not know, such as counts, is kept as
    written.
    """
    plain = [cell.strip().strip("[](){}<>").strip() for cell in cells]
    stated = [cell for cell in plain if cell.lower() not in _NO_UNIT]
    in_brackets = [cell for cell in cells if re.fullmatch(r"\s*[\[({<].*[\])}>]\s*", cell)]
    known = [cell for cell in stated if cell in _OTHER_UNITS or headings.is_unit(cell)]
    is_line = bool(known) and len(cells) <= columns and max(2 * len(known), 2 * len(in_brackets)) >= len(stated)
    found = ["" if not is_line or cell.lower() in _NO_UNIT else cell for cell in plain[:columns]]
    return found + [""] * (columns - len(found))


def _unlabelled(line: str, delimiter: str, columns: int) -> list[str]:
    """Return the cells of a line whose first word says that they are units, "Units: s, N*m" or "Y_Unit_Label".

    The label is the beginning of the first cell, or an extra cell in front of it.
    """
    cells = split_line(_UNITS.sub("", line, count=1).rstrip(), delimiter)
    while cells and not cells[-1]:
        cells.pop()
    return cells[1:] if len(cells) > columns else cells


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit and headings.bracketed_text(name) is None else name


def _example(columns: int, delimiter: str) -> str:
    names = _EXAMPLE[:columns]
    return delimiter.join(name.replace(" ", "") for name in names) if delimiter == " " else delimiter.join(names)


@lru_cache(maxsize=4 * _TOP)
def _split(line: str, delimiter: str) -> tuple[str, ...]:
    try:
        return tuple(cell.strip() for cell in next(_reader([line], delimiter), []))
    except csv.Error:
        return ()


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line, [] if it is not CSV."""
    return list(_split(line, delimiter))


def _reader(lines: Iterable[str], delimiter: str) -> Reader:
    """Return a reader of the rows in the lines; several spaces in sequence are one delimiter."""
    spaced = delimiter == " "
    ended = (line.replace("\t", " ").strip() for line in lines) if spaced else lines
    return csv.reader(ended, delimiter=delimiter, skipinitialspace=True)
