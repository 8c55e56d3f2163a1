"""Read the numbers in the cells of a text table: decimal commas, thousands separators, missing readings, clocks."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from hil.errors import WrongUse

Style = Literal["point", "comma"]

_SHOWN = 40  # characters of a bad cell that are quoted
_MISSING = frozenset(
    {"", "-", "--", "?", "na", "n/a", "#n/a", "#na", "null", "none", "<na>", "nil", "1.#qnan", "1.#ind"}
)
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_IN_GROUPS: Mapping[Style, re.Pattern[str]] = {  # by the decimal mark; the other mark separates thousands
    "point": re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?"),
    "comma": re.compile(r"[-+]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?"),
}
_SPACES = re.compile("['\u2019\u00a0\u202f ]")
_SPACED = re.compile(rf"[-+]?\d{{1,3}}({_SPACES.pattern}\d{{3}})+([.,]\d*)?")
_TIME_OF_DAY = re.compile(r"(?<![\d:])(\d{1,2}):(\d{2}):(\d{2})(?:[.,:](\d+))?\s*([AaPp])?\.?[Mm]?\.?(?![\d:])")
_MINUTES = re.compile(r"(\d{1,3}):(\d{2})[.,](\d+)")  # what Excel shows of a time of day
_DAY, _HOUR = 86400.0, 3600.0


def is_number(text: str) -> bool:
    """Return whether a text is a number in any notation."""
    try:
        float(_plain(text).replace(",", "."))
    except ValueError:
        return any(pattern.fullmatch(_plain(text)) for pattern in _IN_GROUPS.values())
    return "_" not in text


def is_missing(text: str) -> bool:
    """Return whether a text stands for a missing reading: an empty cell, "n/a", "null", ..."""
    return text.strip().lower() in _MISSING


def clock(text: str) -> tuple[float, float] | None:
    """Return a time of day or a date with one, s, and after how many s it begins anew, 0 for a date; None for any
    other text.

    A date that is not as in ISO 8601 is not read, because 05/06 may be in May or June: only its time of day counts.
    """
    if ":" not in text:
        return None
    text = text.strip()
    try:
        date = datetime.fromisoformat(text)
        return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp(), 0.0
    except ValueError:
        pass
    if match := _TIME_OF_DAY.search(text):
        hour, minute, second, rest, half = match.groups()
        hours = int(hour) % 12 + (12 if half in {"p", "P"} else 0) if half else int(hour)
        return 3600.0 * hours + 60.0 * int(minute) + float(f"{second}.{rest or 0}"), _DAY
    if match := _MINUTES.fullmatch(text):
        return 60.0 * int(match[1]) + float(f"{match[2]}.{match[3]}"), _HOUR
    return None


def _plain(text: str) -> str:
    """Return the text of a number with an ASCII minus, and without spaces or apostrophes between thousands."""
    text = text.strip().replace("\u2212", "-")
    return _SPACES.sub("", text) if _SPACED.fullmatch(text) else text


class NotANumber(Exception):
    """A cell holds no number. The text says which cell, and what to do."""


class OtherStyle(Exception):
    """The table must be read again, with this decimal mark."""

    def __init__(self, style: Style) -> None:
        super().__init__(style)
        self.style: Style = style


class Cells:
    """Reads the numbers in cells, and determines whether the file uses decimal points or decimal commas.

    "1,234" may mean 1234 in one program and 1.234 in another. Other numbers of the file decide: "0,5" can only have a
    decimal comma, and "1,004.80" and "0.5" only a decimal point. A file without such a number is refused.
    """

    def __init__(self, names: Sequence[str], clocks: frozenset[int], style: Style | None) -> None:
        self._names = names
        self._clocks = clocks
        self._style = style
        self._last = dict.fromkeys(clocks, math.nan)
        self._sure: dict[Style, str] = {}  # by decimal mark the first number that can only have this one
        self._unsure: dict[Style, str] = {}  # and the first that has it, or separates thousands with it
        self._groups = ""  # the first number with a comma after and a point between the thousands

    def number(self, line: int, at: int, cell: str) -> float:
        """Return the number in a cell; NaN for a missing reading. Raises NotANumber."""
        text = cell.strip()
        try:
            value = float(text)
        except ValueError:
            return self._other(line, at, text)
        if "_" in text:  # only Python separates thousands so
            raise NotANumber(self._bad(line, at, text))
        if "." in text and not ("point" in self._sure and self._style != "comma"):
            if not _IN_GROUPS["comma"].fullmatch(text):
                self._sure.setdefault("point", self._place(line, at, text))
            elif self._style == "comma":
                return float(text.replace(".", ""))
            else:
                self._unsure.setdefault("point", self._place(line, at, text))
        return value

    def _other(self, line: int, at: int, text: str) -> float:
        if is_missing(text):
            return math.nan
        if at in self._clocks and (read := clock(text)):
            return self._going_on(at, *read)
        text, shown = _plain(text), text
        for style, pattern in _IN_GROUPS.items():
            mark, between = (".", ",") if style == "point" else (",", ".")
            if pattern.fullmatch(text) and (mark in text or text.count(between) > 1):
                self._sure.setdefault(style, self._place(line, at, shown))
                self._groups = self._groups or (style if style == "comma" else "")
                return float(text.replace(between, "").replace(mark, "."))
        if _DECIMAL_COMMA.fullmatch(text):
            if not _IN_GROUPS["point"].fullmatch(text):
                self._sure.setdefault("comma", self._place(line, at, shown))
            else:
                self._unsure.setdefault("comma", self._place(line, at, shown))
                if self._style == "point":
                    return float(text.replace(",", ""))
            return float(text.replace(",", "."))
        try:
            if "_" not in text:
                return float(text)
        except ValueError:
            pass
        raise NotANumber(self._bad(line, at, shown))

    def _going_on(self, at: int, time: float, period: float) -> float:
        """Return the time of a clock as one that does not begin anew at midnight, or on the hour."""
        last = self._last[at]
        if period and math.isfinite(last):
            time += period * round((last - time) / period)
        self._last[at] = time
        return time

    def _bad(self, line: int, at: int, text: str) -> str:
        shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
        remedy = "empty the cell where nothing was read"
        if ":" in text:
            remedy = "write times as 2024-05-01 12:00:00.002 or 12:00:00.002, or the time in seconds"
        elif re.match(r"[-+]?[\d.,]+\s*[^\W\d]", text):
            remedy = "write the unit in the heading only, and numbers in the cells"
        return f"row {line}, column {self._names[at]}: {shown!r} is not a number: {remedy}"

    def _place(self, line: int, at: int, text: str) -> str:
        return f"{text!r} in row {line}, column {self._names[at]}"

    def check_commas(self, source: Path) -> None:
        """Raise WrongUse if the file has decimal points and decimal commas, or if every comma may be a thousands
        separator; OtherStyle if its numbers are certain only now.
        """
        point, comma = self._sure.get("point"), self._sure.get("comma")
        unsure_point = self._unsure.get("point")
        if comma and (point or (unsure_point and not self._groups)):
            raise WrongUse(
                f"{source} writes decimals both ways, {point or unsure_point}, and {comma}: write all with a point"
            )
        if comma and unsure_point and self._style is None:
            raise OtherStyle("comma")
        if not comma and (unsure := self._unsure.get("comma")) and self._style is None:
            if point:
                raise OtherStyle("point")
            raise WrongUse(
                f"{source}: {unsure}, may be a decimal or a thousand, like every number with a comma "
                "in the file: write decimals with a point"
            )
