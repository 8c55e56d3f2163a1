"""The file of known loads for `hil calibrate torque --points`."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import NamedTuple

from hil.calibration.torque import GRAVITY
from hil.errors import WrongUse, decimal_comma
from hil.exchange.headings import bracketed_text, unit_of
from hil.recording.input import read_text
from hil.units import factor, quantity

_LARGEST = 1 << 20  # bytes


class Load(NamedTuple):
    """A known load on the torque cell.

    torque: N m. value: the cell's reading; None if the load has not been read yet. name: for messages.
    """

    torque: float
    value: float | None
    name: str


def weight(text: str, arm: float | None) -> Load:
    """Return the load of a mass, such as "0.2" (kg) or "200g", on a lever of length `arm`, m. Raises WrongUse."""
    mass, _ = quantity(text, "mass")
    if arm is None:
        raise WrongUse("a mass makes a torque only on a lever: give the lever's length, such as --arm 50mm")
    return Load(mass * GRAVITY * arm, None, f"the weight {mass:g} kg")


def read_points(path: Path, arm: float | None) -> list[Load]:
    """Return the known loads in a CSV file. Its columns are `mass` or `torque`, and `value` if the cell was read
    already.

    A mass is in kg and a torque in N m, unless the heading names another unit ("mass [g]"). The rows are in the order
    in which the loads are hung. A load on the other side of the lever is negative. arm: length of the lever, m, needed
    for masses. Raises WrongUse with the row that is wrong.
    """
    rows = _rows(path)
    if not rows:
        raise WrongUse(f"{path} is empty: write a row for each load, under the heading mass,value or torque,value")
    columns = _columns(rows[0])
    kind = next((name for name in ("mass", "torque") if name in columns), None)
    if kind is None:
        raise WrongUse(f"{path} has no column mass or torque: its heading is {','.join(rows[0])}")
    if kind == "mass" and arm is None:
        raise WrongUse(f"{path} has masses, which make a torque only on a lever: give its length, such as --arm 50mm")
    title = rows[0][columns[kind]]
    unit = unit_of(title, kind) or bracketed_text(title)
    scale = factor(kind, unit) if unit else 1.0
    loads = []
    for number, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        amount = _number(path, number, row, columns[kind]) * scale
        value = _number(path, number, row, columns["value"]) if "value" in columns else None
        torque = amount * GRAVITY * arm if kind == "mass" and arm is not None else amount
        named = f"the weight {amount:g} kg" if kind == "mass" else f"the torque {amount:g} N m"
        loads.append(Load(torque, value, f"{named} in row {number}"))
    return loads


def _rows(path: Path) -> list[list[str]]:
    """Return the rows of the CSV file, each as a list of texts. Raises WrongUse if the file is no CSV."""
    lines = read_text(path, largest=_LARGEST).splitlines()
    try:
        return list(csv.reader(lines))
    except csv.Error as error:
        raise WrongUse(f"{path} cannot be read as CSV ({error}): write a row for each load") from None


def _columns(titles: list[str]) -> dict[str, int]:
    """Return the index of each known column; the headings may contain a unit."""
    known = ("mass", "torque", "value")
    begun = {place: title.strip().lower() for place, title in enumerate(titles)}
    return {name: place for place, title in begun.items() for name in known if title.startswith(name)}


def _number(path: Path, line: int, row: list[str], place: int) -> float:
    said = row[place] if place < len(row) else "nothing"
    try:
        number = float(said)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise WrongUse(f"{path}, row {line}: {said!r}{decimal_comma(said) or ' is no number'}")
    return number
