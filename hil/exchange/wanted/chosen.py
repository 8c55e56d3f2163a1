"""The columns that a user names for the channels: their units, and sums of columns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from hil import units
from hil.errors import WrongUse
from hil.exchange.columns import Table
from hil.exchange.command import dimension_of_command
from hil.exchange.headings import bracketed_text, unit_of
from hil.exchange.wanted.expression import Term, terms

DIMENSION: Mapping[str, str] = MappingProxyType(
    {
        "time": "time",
        "torque": "torque",
        "dtheta": "angle",
        "dtheta_dot": "rate",
        "motor_torque": "torque",
        "motor_position": "angle",
    }
)
"""The channels for which a column can be named, and the dimension of each. The dimension of the command depends on its
column.
"""


@dataclass(frozen=True, slots=True)
class Column:
    """The column of a table from which a channel is imported.

    name: of the column. unit: None: the unit in the heading ("tau [mN m]", "tau_mNm", "tau/mNm"). scale: a further
    factor on the values; -1 inverts the sign. code: how the numbers have their sign, as in `signs.decoded`; None: they
    are refused if they lack it.
    """

    name: str
    unit: str | None = None
    scale: float = 1.0
    code: str | None = None


def with_sums(table: Table, columns: Mapping[str, Column]) -> tuple[Table, Mapping[str, Column]]:
    """Return the table with a column, in SI, for each channel whose column is a sum of columns, and the columns.

    Raises WrongUse if the unit of a column in a sum is unknown.
    """
    named = dict(columns)
    for channel, column in columns.items():
        parts = terms(column.name, table.place, table.has)
        if parts == [Term(column.name, None, 1.0)]:
            continue
        first = table.titles[table.place(parts[0].column)]
        dimension = DIMENSION.get(channel) or dimension_of_command(first, parts[0].unit or column.unit)
        factors = []
        for part in parts:
            at = table.place(part.column)
            unit = _unit(channel, dimension, table.titles[at], replace(column, unit=part.unit or column.unit))
            if unit is None:
                raise WrongUse(
                    f"{table.source} does not say the unit of {part.column!r}: write it behind the name, such as "
                    f"{part.column}[{units.COMMON[dimension][0]}], or {give(channel)}"
                )
            factors.append((at, part.factor * units.factor(dimension, unit)))
        named[channel] = replace(column, name=f"expression of --{channel.replace('_', '-')}", unit=units.SI[dimension])
        table = table.with_sum(named[channel].name, factors)
    return table, named


def dimensions_of(titles: Mapping[str, str], columns: Mapping[str, Column]) -> Mapping[str, str]:
    """Return the dimension of each channel. Raises WrongUse if the dimension of the command is unknown."""
    if "command" not in columns:
        return DIMENSION
    return {**DIMENSION, "command": dimension_of_command(titles["command"], columns["command"].unit)}


def units_of(titles: Mapping[str, str], columns: Mapping[str, Column]) -> dict[str, str | None]:
    """Return the unit of each channel's column as `_unit` does. titles: the heading of each channel."""
    dimensions = dimensions_of(titles, columns)
    return {name: _unit(name, dimensions[name], titles[name], column) for name, column in columns.items()}


def _unit(channel: str, dimension: str, title: str, column: Column) -> str | None:
    """Return the unit of a column: the given unit, otherwise the unit in the heading; None if both are missing.

    Raises WrongUse if the given unit and the heading's unit differ, and for an unknown unit.
    """
    named = unit_of(title, dimension)
    if column.unit is None:
        if named is None and (text := bracketed_text(title)):
            raise WrongUse(f"column {title!r} names {text!r}, an unknown unit of {dimension}: {give(channel)}")
        return named
    factor = units.factor(dimension, column.unit)
    if named is not None and not math.isclose(units.factor(dimension, named), factor, rel_tol=1e-9):
        raise WrongUse(
            f"column {title!r} is in {named} by its heading and in {column.unit} by the option: correct the heading, "
            "or omit the option"
        )
    return column.unit


def give(channel: str) -> str:
    """Return the option that gives the unit of a channel, and the units that it accepts, for a message."""
    option = channel.replace("motor_torque", "torque").replace("motor_position", "dtheta").replace("_", "-")
    own = "" if channel == "time" else f" (for counts or volts also the factor to it: --{option}-scale)"
    return f"give it with --{option}-unit, one of {', '.join(units.COMMON[DIMENSION[channel]])}{own}"
