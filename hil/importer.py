"""Other people's CSV into a recording: named columns, units, a row filter."""

from __future__ import annotations

import csv
import gzip
import math
import operator
import re
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from types import MappingProxyType
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from hil import units
from hil.errors import WrongUse
from hil.part import Header, write
from hil.stand import Stand

Array = NDArray[np.float64]

_DIMENSION = MappingProxyType(
    {
        "time": "time",
        "torque": "torque",
        "dtheta": "angle",
        "dtheta_dot": "rate",
        "motor_torque": "torque",
        "motor_position": "angle",
    }
)
_COMPARISONS: Mapping[str, Callable[[float, float], bool]] = MappingProxyType(
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
class Column:
    """Where a channel comes from: the column's name in the file and its unit there."""

    name: str
    unit: str


@dataclass(frozen=True, slots=True)
class Condition:
    """A row is kept where `column` compares so with `value`."""

    column: str
    comparison: str
    value: float

    @classmethod
    def parse(cls, text: str) -> Condition:
        """A condition such as "test_nr==100". Raises WrongUse."""
        match = re.fullmatch(r"\s*(.+?)\s*(==|!=|<=|>=|<|>)\s*(\S+)\s*", text)
        if match:
            try:
                return cls(match[1], match[2], float(match[3]))
            except ValueError:
                pass
        raise WrongUse(
            f"--where {text!r}: write a column, one of {' '.join(_COMPARISONS)}, and a number: 'test_nr==100'"
        )

    def holds(self, value: float) -> bool:
        """Whether a row with `value` in the column is kept."""
        return _COMPARISONS[self.comparison](value, self.value)


def import_csv(
    source: Path,
    target: Path,
    columns: Mapping[str, Column],
    where: list[Condition],
    *,
    stand: Stand | None = None,
    command_line: str = "",
) -> int:
    """Write the rows of a CSV (or .csv.gz) that meet every condition as a recording; the number of rows.

    columns: channel (time, torque, dtheta, dtheta_dot, motor_torque, motor_position) to its column; time and either
    torque with dtheta or motor_torque with motor_position and a stand. Raises WrongUse with the row at fault.
    """
    _check_channels(columns, stand)
    factors = {channel: units.factor(_DIMENSION[channel], column.unit) for channel, column in columns.items()}
    names = [column.name for column in columns.values()]
    table, numbers = _read(source, names, where)
    channels = {channel: table[index] * factors[channel] for index, channel in enumerate(columns)}
    _check_time(source, channels["time"], numbers)
    channels["time"] = channels["time"] - channels["time"][0]
    if stand is not None and "motor_torque" in channels:
        ratio = stand.stand.gear_ratio
        channels["torque"] = ratio * channels["motor_torque"]
        position = channels["motor_position"]
        channels["dtheta"] = (position - position[np.isfinite(position)][:1].sum()) / ratio
    header = Header(
        profile={"kind": "imported", "source": source.name, "where": " and ".join(_said(item) for item in where)},
        stand_toml="" if stand is None else stand.text,
        command_line=command_line,
    )
    write(target, header, channels)
    return len(numbers)


def _said(condition: Condition) -> str:
    return f"{condition.column}{condition.comparison}{condition.value:g}"


def _check_channels(columns: Mapping[str, Column], stand: Stand | None) -> None:
    motor = {"motor_torque", "motor_position"}
    if motor & set(columns):
        if not motor <= set(columns) or stand is None:
            raise WrongUse("torque from the motor needs --motor-torque, --motor-position and --stand together")
        if {"torque", "dtheta"} & set(columns):
            raise WrongUse("give either --torque and --dtheta, or --motor-torque and --motor-position")
    elif not {"torque", "dtheta"} <= set(columns):
        raise WrongUse("name the columns: --torque and --dtheta, or --motor-torque, --motor-position and --stand")


def _check_time(source: Path, time: Array, numbers: list[int]) -> None:
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise WrongUse(f"{source}, row {numbers[bad[0]]}: the time is not a number")
    backwards = np.flatnonzero(np.diff(time) < 0.0)
    if backwards.size:
        raise WrongUse(
            f"{source}, row {numbers[backwards[0] + 1]}: the time goes backwards; "
            "if the file holds several runs, choose one with --where"
        )


@contextmanager
def _text(source: Path) -> Iterator[TextIO]:
    try:
        if source.suffix == ".gz":
            with gzip.open(source, "rb") as packed, TextIOWrapper(packed, encoding="utf-8-sig", newline="") as text:
                yield text
        else:
            with source.open(encoding="utf-8-sig", newline="") as text:
                yield text
    except (OSError, EOFError, UnicodeDecodeError, csv.Error, zlib.error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise WrongUse(f"{source} cannot be read ({reason}): check the name, and that it is CSV or .csv.gz") from None


def _read(source: Path, names: list[str], where: list[Condition]) -> tuple[Array, list[int]]:
    """The named columns of the rows that are kept, (columns, rows), and the rows' numbers in the file."""
    kept: list[list[float]] = []
    numbers: list[int] = []
    with _text(source) as text:
        header = text.readline().rstrip("\r\n")
        delimiter = max(",;\t", key=header.count)
        titles = [title.strip() for title in next(csv.reader([header], delimiter=delimiter), [])]
        wanted = [_index(source, titles, name) for name in names]
        tests = [(_index(source, titles, condition.column), condition) for condition in where]
        for number, row in enumerate(csv.reader(text, delimiter=delimiter), start=2):
            if not row:
                continue
            if len(row) != len(titles):
                raise WrongUse(f"{source}, row {number}: {len(row)} fields, but the header names {len(titles)}")
            if all(condition.holds(_number(source, number, titles[at], row[at])) for at, condition in tests):
                kept.append([_number(source, number, titles[at], row[at]) for at in wanted])
                numbers.append(number)
    if not kept:
        what = "no row meets " + " and ".join(_said(condition) for condition in where) if where else "no rows"
        raise WrongUse(f"{source}: {what}")
    return np.array(kept, dtype=np.float64).T, numbers


def _index(source: Path, titles: list[str], name: str) -> int:
    if name not in titles:
        raise WrongUse(f"{source} has no column {name!r}; it has {', '.join(titles)}")
    if titles.count(name) > 1:
        raise WrongUse(f"{source} has {titles.count(name)} columns named {name!r}: rename all but one")
    return titles.index(name)


def _number(source: Path, row: int, title: str, cell: str) -> float:
    """A cell's number; NaN for an empty one, which identification drops and counts."""
    text = cell.strip()
    if not text:
        return math.nan
    try:
        return float(text)
    except ValueError:
        comma = "; write decimals with a point" if re.fullmatch(r"[-+]?\d+,\d+", text) else ""
        raise WrongUse(f"{source}, row {row}, column {title}: {text!r} is not a number{comma}") from None
