"""The columns that a user names for the channels, and their units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

from hil import units
from hil.errors import WrongUse
from hil.exchange.columns import Table
from hil.exchange.headings import bracketed_text, unit_of

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

MODES: Mapping[str, str] = MappingProxyType(
    {"torque": "torque", "angle": "position", "current": "current", "voltage": "voltage"}
)
"""The possible dimensions of a set-point, and the mode of the recording's profile for each."""

_KINDS: Final = "a torque, an angle, a current or a voltage"


@dataclass(frozen=True, slots=True)
class Column:
    """The column of a table from which a channel is imported.

    name: of the column, or a sum of columns. unit: if None, that of the heading ("tau [mN m]", "tau_mNm", "tau/mNm").
    scale: a further factor on the values; -1 inverts the sign. code: how the numbers encode their sign, such as
    "wrap=65536"; None: numbers that lack their sign are refused.
    """

    name: str
    unit: str | None = None
    scale: float = 1.0
    code: str | None = None


class Part(NamedTuple):
    """A column in the sum that gives a channel. title: its heading. unit: None if neither heading nor user states it.
    factor: its weight in the sum, without conversion of units. named: the user's name for it.
    """

    title: str
    unit: str | None
    factor: float
    named: str


def parts_of(table: Table, channel: str, column: Column) -> tuple[str, list[Part]]:
    """Return the dimension of a channel, and the columns whose sum it is: mostly one.

    Raises WrongUse for a column that is not there, for an unknown unit, and if option and heading state two units.
    """
    found = [(one, table.titles[table.place(one.column)]) for one in table.terms(column.name)]
    first, title = found[0]
    dimension = DIMENSION.get(channel) or dimension_of_command(title, first.unit or column.unit)
    return dimension, [
        Part(title, _unit(channel, dimension, title, one.unit or column.unit), one.factor * column.scale, one.column)
        for one, title in found
    ]


def dimension_of_command(title: str, unit: str | None) -> str:
    """Return the dimension of a command from its unit: `unit` if given, otherwise the unit in the heading `title`.
    Raises WrongUse if there is no unit.

    The command is the instrument of the identification of Kc and Bc; only its shape matters, not its scale.
    """
    give = (
        f"give the unit of the command with --command-unit, such as {', '.join(units.COMMON[one][0] for one in MODES)}"
    )
    if unit is not None:
        found = next((one for one in MODES if units.known(one, unit) is not None), None)
        if found is None:
            raise WrongUse(f"--command-unit {unit}: {unit} is not a unit of {_KINDS}: {give}")
        return found
    for dimension in MODES:
        try:
            if unit_of(title, dimension) is not None:
                return dimension
        except WrongUse:  # a heading of another dimension
            continue
    raise WrongUse(f"column {title!r} does not say whether the command is {_KINDS}: {give}")


def _unit(channel: str, dimension: str, title: str, given: str | None) -> str | None:
    """Return the unit of a column: the given unit, otherwise the unit in the heading; None if both are missing.

    Raises WrongUse if the given unit and the heading's unit differ, and for an unknown unit.
    """
    named = unit_of(title, dimension)
    if given is None:
        if named is None and (text := bracketed_text(title)):
            raise WrongUse(
                f"column {title!r} names {text!r}, an unknown unit of {dimension}: {give(channel, dimension)}"
            )
        return named
    factor = units.factor(dimension, given)
    if named is not None and not math.isclose(units.factor(dimension, named), factor, rel_tol=1e-9):
        raise WrongUse(
            f"column {title!r} is in {named} by its heading and in {given} by the option: correct the heading, or omit "
            "the option"
        )
    return given


def give(channel: str, dimension: str) -> str:
    """Return words for a message: the option that gives the unit of a channel, and the units of `dimension` that it
    accepts.
    """
    option = channel.replace("motor_torque", "torque").replace("motor_position", "dtheta").replace("_", "-")
    own = "" if channel == "time" else f" (for counts or volts also the factor to it: --{option}-scale)"
    return f"give it with --{option}-unit, one of {', '.join(units.COMMON[dimension])}{own}"
