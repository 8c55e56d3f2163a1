"""The export of a recording as a table: every channel a column, with its unit in the heading."""

from __future__ import annotations

import csv
import gzip
import math
from pathlib import Path

from hil.errors import WrongUse
from hil.exchange.columns import parquet
from hil.exchange.headings import heading
from hil.recording.channels import CHANNELS
from hil.recording.output import atomic_write
from hil.recording.reader import Recording

_SUFFIXES = (".csv", ".csv.gz", ".parquet")


def check_format(target: Path) -> None:
    """Raise WrongUse where the target's name does not end like a CSV or Parquet file."""
    if not target.name.endswith(_SUFFIXES):
        raise WrongUse(f"{target}: an export is {', '.join(_SUFFIXES)}: name the output so")


def export(path: Path, target: Path, *, force: bool = False) -> int:
    """Write every row and channel of a recording, in SI, and return the number of rows. A NaN is an empty CSV cell.

    No digit is lost: `hil import` without columns reads the same numbers back. force: replace a file of that name.
    Raises WrongUse, Untrustworthy for a recording that is damaged or was changed.
    """
    check_format(target)
    write = _write_parquet if target.suffix == ".parquet" else _write_csv
    with Recording(path) as recording, atomic_write(target, force=force) as temporary:
        recording.check_unchanged()
        write(recording, temporary, packed=target.suffix == ".gz")
        return len(recording)


def _write_csv(recording: Recording, target: Path, *, packed: bool) -> None:
    with (gzip.open if packed else open)(target, "wt", encoding="utf-8", newline="") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([heading(name) for name in CHANNELS])
        for _, rows in recording.rows():
            for row in rows.tolist():
                writer.writerow(["" if isinstance(value, float) and math.isnan(value) else value for value in row])


def _write_parquet(recording: Recording, target: Path, *, packed: bool) -> None:
    del packed
    module = parquet(target)
    import pyarrow

    schema = pyarrow.schema([(heading(name), pyarrow.float64()) for name in CHANNELS])
    with module.ParquetWriter(target, schema) as writer:
        for _, rows in recording.rows():
            columns = {heading(name): rows[name].astype("f8") for name in CHANNELS}
            writer.write_table(pyarrow.table(columns, schema=schema))
