"""A recording as a table for other programs: every channel a column, its unit in the heading."""

from __future__ import annotations

import csv
import gzip
import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from hil.errors import WrongUse
from hil.exchange.columns import parquet
from hil.recording.output import writing
from hil.recording.reader import CHANNELS, Recording

_SUFFIXES = (".csv", ".csv.gz", ".parquet")


def heading(channel: str) -> str:
    """A channel's column in an export, such as "torque [N*m]"."""
    return f"{channel} [{CHANNELS[channel][0]}]"


def check_format(target: Path) -> None:
    """Raise WrongUse where the target's name does not say CSV or Parquet."""
    if not target.name.endswith(_SUFFIXES):
        raise WrongUse(f"{target}: an export is {', '.join(_SUFFIXES)}: name the output so")


def export(path: Path, target: Path) -> int:
    """Write every row and channel of a recording, in SI; the number of rows. A NaN is an empty cell in CSV.

    The numbers are written so that reading them gives the same ones: `hil import` without columns takes them back.
    Raises WrongUse, Untrustworthy where the recording is damaged.
    """
    check_format(target)
    temporary = target.with_name(f".{target.name}.part")
    with Recording(path) as recording:
        try:
            with writing(target):
                write = _write_parquet if target.suffix == ".parquet" else _write_csv
                write(recording, temporary)
                temporary.replace(target)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
        return len(recording)


def _write_csv(recording: Recording, target: Path) -> None:
    with _open(target) as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([heading(name) for name in CHANNELS])
        for row in _rows(recording):
            writer.writerow(["" if isinstance(value, float) and math.isnan(value) else value for value in row])


def _open(target: Path) -> TextIO:
    if ".csv.gz" in target.name:
        return gzip.open(target, "wt", encoding="utf-8", newline="")
    return target.open("w", encoding="utf-8", newline="")


def _rows(recording: Recording) -> Iterator[tuple[float, ...]]:
    for _, rows in recording.rows():
        yield from rows.tolist()


def _write_parquet(recording: Recording, target: Path) -> None:
    module = parquet(target)
    import pyarrow

    schema = pyarrow.schema([(heading(name), pyarrow.float64()) for name in CHANNELS])
    with module.ParquetWriter(target, schema) as writer:
        for _, rows in recording.rows():
            columns = {heading(name): rows[name].astype("f8") for name in CHANNELS}
            writer.write_table(pyarrow.table(columns, schema=schema))
