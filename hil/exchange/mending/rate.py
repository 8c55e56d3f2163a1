"""Times of rows that have none: counted at a rate that the user states, and the rate that a file states."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil import units
from hil.errors import WrongUse
from hil.exchange.columns import Table

Array = NDArray[np.float64]

_NUMBER = r"[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?"
_SAYS_RATE = r"(?:sampl\w*|acquisition|scan|data|logging)?[\s_.-]*(?:rate|freq(?:uency)?)\b|f_?s\b|\bsps\b|abtastrate"
_SAYS_STEP = (
    r"(?:sampl\w*|time)[\s_.-]*(?:interval|period|step|time)\b|delta[\s_]?[xt]\b|(?:x[\s_]?)?increment\b|dt\b|ts\b|"
    r"h[\s_]?resolution\b|t[\s_]?inc\b|t_?step\b|wf_increment\b|abtastintervall"
)
_UNIT = r"k?Hz|[mun]?s(?:ec)?"
_STATED = re.compile(
    rf"(?<![a-z])(?:(?P<rate>{_SAYS_RATE})|(?P<step>{_SAYS_STEP}))[\s_]*(?:[\[(]?(?P<before>{_UNIT})[\])]?)?"
    rf"[\"\s]*[\s,;:=][\"\s]*(?P<number>{_NUMBER})(?:[\s,;\"]*(?P<unit>{_UNIT})\b)?",
    re.IGNORECASE,
)
_RATES = (1.0, 1e6)  # Hz, outside which a number is no rate of a logger
_MOST = 1000  # columns in which a rate is looked for


def counted(counter: Array | None, rows: NDArray[np.int64], rate: float) -> tuple[Array, float]:
    """Return the times (n,), s, of rows at an even rate, Hz, and the time of one count, s.

    counter (n,): a column that counts the rows; None: rows (n,), their numbers in the file.
    """
    count = rows.astype(np.float64) if counter is None else counter
    steps = np.abs(np.diff(count))
    each = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
    return count / (each * rate), 1.0 / (each * rate)


def advice(table: Table) -> str:
    """Return words for a message: how to state the rate of even rows, and what the file says about it."""
    for text, rate in _stated(table):
        return f"state the rate of even rows: --rate {rate:.9g}, as the file says ({text})"
    return "state the rate of even rows, such as --rate 500"


def stated_rate(table: Table) -> float | None:
    """Return the rate of the rows that a file states, Hz; None if it states none."""
    return next((rate for _, rate in _stated(table)), None)


def _stated(table: Table) -> Iterator[tuple[str, float]]:
    """Yield the rates, Hz, that the lines above a text table or the single numbers in another file state."""
    cells = [re.split("[,;\t]", line.strip()) for line in table.above]
    below = [f"{one}={two}" for line, after in pairwise(cells) for one, two in zip(line, after, strict=False)]
    for text in [*table.above, *below, *_single_numbers(table)]:
        for found in _STATED.finditer(text):
            number = float(found["number"].replace(",", "."))
            unit = found["unit"] or found["before"] or ("Hz" if found["rate"] else "s")
            factor = units.known("frequency" if found["rate"] else "time", unit) or math.nan
            with suppress(ZeroDivisionError):
                rate = number * factor if found["rate"] else 1.0 / (number * factor)
                if _RATES[0] <= rate <= _RATES[1]:
                    yield found[0].strip(), float(f"{rate:.9g}")


def _single_numbers(table: Table) -> Iterable[str]:
    for title in table.titles[:_MOST] if not table.above else ():
        name = re.split(r"[./]", title)[-1]
        if _STATED.match(f"{name}=1"):
            with suppress(WrongUse):
                values = table.read([title], [])[0]
                if values.size == 1:
                    yield f"{name} = {float(values[0, 0]):.9g}"
