"""Read JSON: an object in each line (.jsonl, .ndjson), a list of objects, or an object of lists."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import WrongUse
from hil.exchange.nested import columns, names_of, written
from hil.exchange.readers.columns import Columns, loaded


def read(source: Path) -> Columns:
    """Return the columns by path: "tau", "joint.q", "q[2]". A line that is cut off at the end of the file is left out.

    Raises WrongUse with the line that is no JSON.
    """
    text = source.read_text(encoding="utf-8-sig")
    try:
        return loaded(_of_document("", json.loads(text)))
    except json.JSONDecodeError:
        lines = [(at, line) for at, line in enumerate(text.splitlines(), start=1) if line.strip()]
    rows: list[Any] = []
    for at, line in lines:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError as error:
            if rows and at == lines[-1][0] and not text.endswith("\n"):
                break  # the power was lost while it was written
            what = f"this is not JSON ({error.msg}): mend the line, or delete it"
            raise WrongUse(f"{source}, line {at}: {what}") from None
    return loaded(columns("JSON", enumerate(rows)).values)


def _of_document(name: str, value: Any, beside: Any = None) -> dict[str, Any]:
    """Return the columns in one JSON value: a list of numbers is a column, a list of objects or lists a table."""
    if isinstance(value, dict) and len(value) > 1 and all(map(str.isdecimal, value)):  # rows of a data frame by number
        value = [*value.values()]
    if isinstance(value, dict):
        names = {**(beside or {}), **names_of(value.values())}
        inner = {f"{name}.{key}" if name else key: item for key, item in value.items()}
        return {path: column for key, item in inner.items() for path, column in _of_document(key, item, names).items()}
    rows = value if isinstance(value, list) else [value]
    if rows and all(isinstance(item, list) for item in rows) and len(rows) < len(rows[0]):  # lists are columns
        rows = np.array(rows, dtype=object).T.tolist()
    found = columns("JSON", enumerate(rows), beside=beside).values
    return {written([one for one in (name, path) if one]): column for path, column in found.items()}
