"""Read the numbers in the cells of a text table: decimal commas, thousands separators, missing readings, clocks."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

from hil.errors import WrongUse

_SHOWN = 40  # characters of a bad cell that are quoted
_MISSING = frozenset(
    ["", "-", "--", "?", "na", "n/a", "#n/a", "#na", "null", "none", "<na>", "nil", "1.#qnan", "1.#ind"]
)
_EXPONENT = r"(?:[eE][-+]?\d+|(?<=[\d.,])[dD][-+]\d+)?"  # Fortran writes 1.0D-03
_NUMBER = rf"[-+]?(?:[1-9]\d{{{{0,2}}}}(?:\{{between}}\d{{{{3}}}})+|\d*)(?:\{{mark}}\d*)?{_EXPONENT}"
_NUMBERS = {  # by the decimal mark; the other mark separates thousands
    ".": re.compile(_NUMBER.format(mark=".", between=",")),
    ",": re.compile(_NUMBER.format(mark=",", between=".")),
}
_DECIMAL = re.compile(r"(?<![\w.])[-+]?\d*\.\d+(?![\w.])")
_FIRST = 1000  # numbers of a block that show the decimal mark
_SPACES = re.compile("['\u2019\u00a0\u202f ]")
_SPACED = re.compile(rf"[-+]?\d{{1,3}}({_SPACES.pattern}\d{{3}})+([.,]\d*)?")
_TIME_OF_DAY = re.compile(r"(?<![\d:])(\d{1,2}):(\d{2}):(\d{2})(?:[.,:](\d+))?\s*([AaPp])?\.?[Mm]?\.?(?![\d:])")
_MINUTES = re.compile(r"(\d{1,3}):(\d{2})[.,](\d+)")  # what Excel shows of a time of day
LISTS = re.compile(r"[\[(]\s*[-+]?[\d.]+(?:[eE][-+]?\d+)?(?:[\s,;]+[-+]?[\d.]+(?:[eE][-+]?\d+)?)+\s*[\])]")
_DAY, _HOUR = 86400.0, 3600.0


def is_missing(text: str) -> bool:
    """Return whether a text stands for a missing reading: an empty cell, "n/a", "null", ..."""
    return text.strip().lower() in _MISSING


def is_number(text: str) -> bool:
    """Return whether a text is a number in any notation."""
    try:
        float(text)  # nearly every number has this notation; to try the others takes ten times as long
    except ValueError:
        return bool(_values(_plain(text)))
    return "_" not in text


def clock(text: str) -> tuple[float, float] | None:
    """Return the time of a clock or a date, s, and the period, s, after which it begins anew (0 for a date); None for
    any other text.

    Of a date that is not in ISO 8601 only the time of day is read, because 05/06 may be in May or in June.
    """
    if ":" not in text:
        return None
    with suppress(ValueError):
        date = datetime.fromisoformat(text.strip())
        return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp(), 0.0
    if match := _TIME_OF_DAY.search(text):
        hour, minute, second, rest, half = match.groups()
        hours = int(hour) % 12 + (12 if half in {"p", "P"} else 0) if half else int(hour)
        return 3600.0 * hours + 60.0 * int(minute) + float(f"{second}.{rest or 0}"), _DAY
    if match := _MINUTES.fullmatch(text.strip()):
        return 60.0 * int(match[1]) + float(f"{match[2]}.{match[3]}"), _HOUR
    return None


def _plain(text: str) -> str:
    """Return the text of a number with an ASCII minus, and without spaces or apostrophes between thousands."""
    text = text.strip().replace("\u2212", "-")
    return _SPACES.sub("", text) if _SPACED.fullmatch(text) else text


def _values(text: str) -> dict[str, float]:
    """Return the number in a text for each decimal mark that the text allows; {} for no number."""
    found = {}
    for mark, pattern in _NUMBERS.items():
        between = "," if mark == "." else "."
        with suppress(ValueError):
            if pattern.fullmatch(text):
                found[mark] = float(re.sub("[dD]", "e", text.replace(between, "").replace(mark, ".")))
    with suppress(ValueError):  # NaN, inf; but only Python separates thousands with "_"
        return found or ({"": float(text)} if "_" not in text else {})
    return found


class NotANumber(Exception):
    """A cell holds no number. The text says which cell, and what to do."""


class Cells:
    """Reads the numbers in cells, and determines whether the file uses decimal points or decimal commas.

    "1,234" may mean 1234 in one program and 1.234 in another. Other numbers of the file decide: "0,5" can only have a
    decimal comma, and "1,004.80" and "0.5" only a decimal point. A file without such a number is refused.
    """

    def __init__(self, names: Sequence[str], clocks: frozenset[int], mark: str = ".") -> None:
        """names: headings. clocks: indices of columns with times. mark: the decimal mark if a number may have
        either.
        """
        self._names, self._clocks, self._mark = names, clocks, mark
        self._last = dict.fromkeys(clocks, math.nan)
        self._sure: dict[str, str] = {}  # by decimal mark the first number that can have no other
        self._unsure: dict[str, str] = {}  # by mark the first number in which it may also separate thousands
        self._groups = False  # whether a number shows that points separate thousands

    def number(self, line: int, at: int, cell: str) -> float:
        """Return the number in a cell; NaN for a missing reading. at: index of the column. Raises NotANumber."""
        text = cell.strip()
        if "." not in text or ("." in self._sure and self._mark == "."):  # it shows nothing new
            with suppress(ValueError):
                if "_" not in text:
                    return float(text)
        if is_missing(text):
            return math.nan
        if at in self._clocks and (read := clock(text)):
            return self._going_on(at, *read)
        values = _values(_plain(text))
        if not values:
            raise NotANumber(self._bad(line, at, text))
        place = f"{text!r} in row {line}, column {self._names[at]}"
        mark = next((one for one in ".," if one in text), "")
        if len(values) == 1:
            [only] = values
            self._sure.setdefault(only, place)
            self._groups |= only == "," and "." in text
        elif mark:
            self._unsure.setdefault(mark, place)
        return values.get(self._mark, next(iter(values.values())))

    def look_for_points(self, text: str) -> None:
        """Note whether a number in a text without commas within its cells can only have a decimal point."""
        for match in islice(_DECIMAL.finditer(text), 0 if "." in self._sure else _FIRST):
            if [*_values(match[0])] == ["."]:
                self._sure["."] = repr(match[0])
                return

    @property
    def has_commas(self) -> bool:
        """Return whether a number can only have a decimal comma."""
        return "," in self._sure

    def _going_on(self, at: int, time: float, period: float) -> float:
        """Return the time of a clock, continued past midnight or past the full hour. at: index of the column. period:
        s, after which the clock begins anew.
        """
        if period and math.isfinite(self._last[at]):
            time += period * round((self._last[at] - time) / period)
        self._last[at] = time
        return time

    def _bad(self, line: int, at: int, text: str) -> str:
        shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
        remedy = "empty the cell where nothing was read"
        if ":" in text:
            remedy = "write times as 2024-05-01 12:00:00.002 or 12:00:00.002, or the time in seconds"
        elif LISTS.match(text):
            remedy = "it is a list whose order no heading names: write each number of it into a column, as q0 [rad]"
        elif re.match(r"[-+]?[\d.,]+\s*[^\W\d]", text):
            remedy = "write the unit in the heading only, and numbers in the cells"
        return f"row {line}, column {self._names[at]}: {shown!r} is not a number: {remedy}"

    def other_mark(self, source: Path) -> str | None:
        """Return the decimal mark with which the table must be read again, None if it was read right.

        Raises WrongUse if the file has decimal points and decimal commas, or if every comma may separate thousands.
        """
        point, comma = self._sure.get("."), self._sure.get(",")
        point_too = point or ("" if self._groups else self._unsure.get("."))
        if comma and point_too:
            raise WrongUse(f"{source} writes decimals both ways, {point_too}, and {comma}: write all with a point")
        if not point and not comma and "," in self._unsure:
            raise WrongUse(
                f"{source}: {self._unsure[',']}, may be a decimal or a thousand, like every number with a comma in the "
                "file: write decimals with a point"
            )
        return "," if comma and self._unsure and self._mark != "," else None
