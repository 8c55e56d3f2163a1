"""The rows of a table from one time to another, on the clock of the file."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil import units
from hil.errors import WrongUse
from hil.exchange.readers.columns import seconds

Array = NDArray[np.float64]

_DAY = 86_400.0  # s


def rows_between(source: Path, time: Array, unit: float, first: str | None, last: str | None) -> NDArray[np.bool_]:
    """Return which rows (n,) are from `first` to `last`, both included; None: no bound.

    time (n,): as in the file, s. unit: s; that of a bound without a unit. A bound is a time as the file has it ("12.5",
    "2 min"), a date and time, or a time of day. Raises WrongUse, with the times of the file, if no row is left.
    """
    known = time[np.isfinite(time)]
    start, end = (
        None if text is None else _bound(option, text, known, unit)
        for option, text in (("--from", first), ("--to", last))
    )
    kept = (time >= (-np.inf if start is None else start)) & (time <= (np.inf if end is None else end))
    if not kept.any():
        raise WrongUse(
            f"{source}: no row is between --from and --to, because its times are from {_written(known.min(), unit)} to "
            f"{_written(known.max(), unit)}: give times as the file has them"
        )
    return kept


def _bound(option: str, text: str, time: Array, unit: float) -> float:
    if (found := seconds(text)) is None:
        try:
            number, dimension = units.quantity(text, "time")
        except WrongUse as error:
            raise WrongUse(
                f"{option}: {error}; or a date and time such as '2024-05-01 12:30:00', or a time of day"
            ) from None
        return number * (unit if dimension is None else 1.0)
    if 0.0 <= found < _DAY:  # a time of day: that nearest to the middle of the file
        middle = 0.5 * float(time.min() + time.max())
        found += _DAY * round((middle - found) / _DAY)
    return found


def _written(time: float, unit: float) -> str:
    return str(datetime.fromtimestamp(time, UTC).replace(tzinfo=None)) if time > _DAY * 365.0 else f"{time / unit:.9g}"
