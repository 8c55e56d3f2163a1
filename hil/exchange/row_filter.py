"""Row filters: they select rows of a table by comparing a column with a number."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse

_COMPARISONS: Mapping[str, Callable[..., bool | np.bool_ | NDArray[np.bool_]]] = MappingProxyType(
    {
        "==": operator.eq,
        "!=": operator.ne,
        "<=": operator.le,
        ">=": operator.ge,
        "<": operator.lt,
        ">": operator.gt,
    }
)


@dataclass(frozen=True, slots=True)
class RowFilter:
    """A filter that passes the rows in which the comparison of `column` with `value` is true."""

    column: str
    comparison: str
    value: float

    @classmethod
    def parse(cls, text: str) -> RowFilter:
        """Return the filter described by a text such as "test_nr==100". Raises WrongUse."""
        match = re.fullmatch(r"\s*(.+?)\s*(==|!=|<=|>=|<|>)\s*(\S+)\s*", text)
        if match:
            try:
                return cls(match[1], match[2], float(match[3]))
            except ValueError:
                pass
        raise WrongUse(
            f"--where {text!r}: write a column, one of {' '.join(_COMPARISONS)}, and a number: 'test_nr==100'"
        )

    def __str__(self) -> str:
        return f"{self.column}{self.comparison}{self.value:g}"

    def keeps(self, value: float) -> bool:
        """Return whether a row with `value` in the filter's column passes."""
        return bool(_COMPARISONS[self.comparison](value, self.value))

    def mask(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return for each of the `values` (n,) in the filter's column whether its row passes, (n,)."""
        return np.asarray(_COMPARISONS[self.comparison](values, self.value), dtype=np.bool_)
