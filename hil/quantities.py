"""Values with a unit in a file that a person writes: `watchdog = "100 ms"`, `torque_constant = "14.5 mN*m/A"`.

Each table of such a file has a Python class. A field of that class that is a physical quantity is annotated with its SI
unit, `annotated_types.Unit`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import lru_cache
from typing import Any, get_args, get_type_hints

from annotated_types import Unit
from pydantic import BaseModel

from hil.errors import WrongUse
from hil.units import dimension_of, factor, printed, quantity


@dataclass(frozen=True, slots=True)
class Usual:
    """The largest value, SI, that a number without a unit may have; a larger value needs its unit in the file.

    units: the units in which a larger number was probably meant, the likeliest first.
    """

    most: float
    units: tuple[str, ...]


_USUAL = {"N*m/A": Usual(10.0, ("mN*m/A",))}
"""By unit: of quantities in the tables of drives, which do not know this module."""

Place = tuple[str | int, ...]
"""The keys that lead to a value, from the outermost table inwards."""


def in_si(table: Mapping[str, Any], kind: type) -> tuple[dict[str, Any], dict[Place, str]]:
    """Return `table` with texts such as "10 ms" converted to numbers in SI, and a sentence for each text that has no
    valid unit.

    kind: class of the table, a dataclass or a pydantic model. A value with another kind of error is returned unchanged.
    """
    found: dict[str, Any] = dict(table)
    wrong: dict[Place, str] = {}
    for key, hint in _hints(kind):
        if key in table:
            found[key], mine = _value(table[key], hint)
            wrong |= {(key, *place): text for place, text in mine.items()}
    return found, wrong


def _value(value: Any, hint: Any) -> tuple[Any, dict[Place, str]]:
    inner = next((part for part in _parts(hint) if _is_table(part)), None)
    if isinstance(value, dict) and inner is not None:
        return in_si(value, inner)
    if isinstance(value, list):
        return _values(value, hint)
    if isinstance(value, bool) and _is_number(hint):  # else `torque = true` would be a limit of 1 N m
        return value, {(): f"{str(value).lower()} is not a number"}
    unit = unit_of(hint)
    return (value, {}) if unit is None else _quantity(value, unit, hint)


def _quantity(value: Any, unit: str, hint: Any) -> tuple[Any, dict[Place, str]]:
    """Return a physical quantity in the SI unit `unit`, and what is wrong with it. A number of usual size needs no
    unit.
    """
    number, dimension = value, None
    if isinstance(value, str):
        try:
            number, dimension = quantity(value, dimension_of(unit))
        except WrongUse as error:
            return value, {(): str(error)}
    if (
        dimension is not None
    ):  # rounded to what the text can have meant, so that "508 us" is not above a bound of 508e-6
        return float(f"{number:.15g}"), {}
    meant = _meant(number, unit, hint)
    return value, {(): meant} if meant else {}


def _meant(value: Any, unit: str, hint: Any) -> str:
    """Return a sentence about a number that cannot be meant in the SI unit `unit`, "" for any other value. hint: the
    type hint of the key.
    """
    usual = next((part for part in _parts(hint) if isinstance(part, Usual)), _USUAL.get(unit))
    if usual is None or not isinstance(value, int | float) or not usual.most < value <= sys.float_info.max:
        return ""
    known = [one for one in usual.units if value * factor(dimension_of(unit), one) <= usual.most]
    likely = (known or usual.units)[0]
    stated = f'"{value:g} {unit}"'
    return f'{value:g} would be {value:g} {printed(unit)}: write "{value:g} {likely}", or {stated} if it is that'


def _values(values: list[Any], hint: Any) -> tuple[list[Any], dict[Place, str]]:
    """Return the elements of a list converted to SI as the type `hint` says, and a sentence for each wrong element."""
    read = [_value(value, hint) for value in values]
    wrong = {(at, *place): text for at, (_, mine) in enumerate(read) for place, text in mine.items()}
    return [value for value, _ in read], wrong


def unit_of(hint: Any) -> str | None:
    """Return the SI unit in a type hint, None if the hint is not that of a physical quantity."""
    return next((part.unit for part in _parts(hint) if isinstance(part, Unit)), None)


def physical(kind: type) -> Iterator[tuple[type, str, str]]:
    """Yield every physical quantity of a table and of the tables inside it: the table's class, the key and the SI
    unit.
    """
    for key, hint in _hints(kind):
        if (unit := unit_of(hint)) is not None:
            yield kind, key, unit
        for part in _parts(hint):
            if _is_table(part):
                yield from physical(part)


def keys_of(kind: type, place: Sequence[str]) -> list[str]:
    """Return the keys of the table at `place` inside a table of class `kind`; an empty list if there is no such
    table.
    """
    for name in place:
        hint = dict(_hints(kind)).get(name)
        inner = next((part for part in _parts(hint) if _is_table(part)), None)
        if inner is None:
            return []
        kind = inner
    return [key for key, _ in _hints(kind)]


def choices(kind: type, key: str) -> tuple[str, ...]:
    """Return the texts that a key of a table can have; () if it can have any text, or no text."""
    values = [value for part in _parts(dict(_hints(kind)).get(key)) for value in get_args(part)]
    return tuple(value for value in values if isinstance(value, str))


@lru_cache(maxsize=256)
def _hints(kind: type) -> list[tuple[str, Any]]:
    hints = get_type_hints(kind, include_extras=True)
    return [(key, hint) for key, hint in hints.items() if not key.startswith("_") and key != "model_config"]


def _parts(hint: Any) -> Iterator[Any]:
    """Yield a type hint, the types of which it consists, and their annotations."""
    yield hint
    for part in (*get_args(hint), *getattr(hint, "__metadata__", ())):
        yield from _parts(part)


def _is_number(hint: Any) -> bool:
    parts = list(_parts(hint))
    return bool not in parts and any(part in (int, float) or type(part) is int for part in parts)


def _is_table(part: Any) -> bool:
    return isinstance(part, type) and (is_dataclass(part) or issubclass(part, BaseModel))
