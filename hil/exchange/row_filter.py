"""Row filters: they select rows of a table by comparing a column with a number, a time or a text."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from hil.errors import WrongUse, decimal_comma
from hil.recording.interval import seconds

_COMPARISONS: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {"==": operator.eq, "!=": operator.ne, "<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt}
)
_DAY = 86400.0  # s


@dataclass(frozen=True, slots=True)
class RowFilter:
    """A filter that passes the rows in which the comparison of `column` with `value` is true.

    value: a number; s for a time; or a text. of_day: whether the value is a time of day, which dates have too. written:
    the time as the user wrote it.
    """

    column: str
    comparison: str
    value: float | str
    of_day: bool = False
    written: str = ""

    @classmethod
    def parse(cls, text: str) -> RowFilter:
        """Return the filter described by a text such as "test_nr==100", "state==run" or "stamp>=12:30:00". Raises
        WrongUse.
        """
        match = re.fullmatch(r"\s*(.+?)\s*(==|!=|<=|>=|<|>)\s*(.+?)\s*", text)
        if match is None:
            raise WrongUse(
                f"--where {text!r}: write a column, one of {' '.join(_COMPARISONS)}, and a number, a time or a text: "
                "'test_nr==100', 'stamp>=12:30:00', 'state==run'"
            )
        column, comparison, value = match.groups()
        with suppress(ValueError):
            return cls(column, comparison, float(value))
        if comma := decimal_comma(value):
            raise WrongUse(f"--where {text!r}{comma}")
        if (found := seconds(value)) is not None:
            return cls(column, comparison, found, 0.0 <= found < _DAY, value)
        if comparison not in {"==", "!="}:
            raise WrongUse(f"--where {text!r}: {value!r} is no number and no time: compare a text with == or !=")
        return cls(column, comparison, value[1:-1] if value[0] == value[-1] in {"'", '"'} else value)

    def __str__(self) -> str:
        value = self.value if isinstance(self.value, str) else f"{self.value:g}"
        return f"{self.column}{self.comparison}{self.written or value}"

    def keeps(self, values: Any) -> Any:
        """Return whether a row passes, or each of the rows (n,). values: the number or text in the filter's column, or
        those of all rows (n,).
        """
        if self.written:  # a double holds a date to a fraction of a microsecond
            values = np.round(values % _DAY if self.of_day else values, 6)
        return _COMPARISONS[self.comparison](values, self.value)
