"""Columns from nested rows, as messages and lines of JSON are: each value has a path of fields and of names that stand
beside it.

The order of the joints in a message changes from start to start. So where a list of names stands beside the values, as
in a DynamicJointState, a value is found by its name; it has no index.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.recording.interval import seconds

Names = Mapping[int, tuple[str, ...]]  # the names beside values, by their number

_MOST_VALUES = 256  # of one array without names
_MOST_COLUMNS = 10_000
_NAMING = ("name", "key", "child_frame_id", "joint_name", "joint", "id")  # fields with the name of what they are in
_NOT_READ = frozenset({"__msgtype__", "header"})


class Value(NamedTuple):
    """A number, a text or a date in a row. path: the fields and names that lead to it. named: the names among them."""

    path: tuple[str, ...]
    value: Any
    named: tuple[str, ...]


class Columns(NamedTuple):
    """The values in rows. read: the number of rows. stamps: of the rows with values, ns. values: the columns by
    heading, (n,) each. joint: the joint's name, which is left out of the paths. joints: the outermost names of all
    paths.
    """

    read: int
    stamps: Sequence[int]
    values: dict[str, NDArray[Any]]
    joint: str | None
    joints: list[str]


def columns(
    source: str, rows: Iterable[tuple[int, Any]], joint: str | None = None, *, alone: bool = False, beside: Any = None
) -> Columns:
    """Return the values in nested rows as columns. A value that a row lacks is NaN.

    rows: each with its stamp, ns. joint: return only values with this name in their path; their headings are the last
    part of the path, where that is unique. alone: if there is only one name, treat it as `joint`; keep the values of
    other names beside those of `joint`, which show whether other joints moved too. beside: names that stand beside all
    rows. Raises WrongUse for more than 10,000 columns.
    """
    stamps, kept, joints, read = array("q"), dict[tuple[str, ...], Any](), dict[str, None](), 0
    for stamp, row in rows:
        read += 1
        values = list(_values((), (), row, beside or {}))
        beside = {**(beside or {}), **names_of((_fields(row) or {}).values())}  # some send the names only once
        joints.update((one.named[0], None) for one in values if one.named)
        if joint is not None and not (own := [one for one in values if joint in one.named]):
            continue
        values = values if joint is None or alone else own
        for one in values:
            column = kept.setdefault(one.path, array("d"))
            column.extend([math.nan] * (len(stamps) - len(column)))
            try:
                column.append(math.nan if one.value is None else one.value)
            except (TypeError, OverflowError):  # no number
                kept[one.path] = [*column, one.value]
        stamps.append(stamp)
        if len(kept) > _MOST_COLUMNS:
            raise WrongUse(f"{source}: its rows hold more than {_MOST_COLUMNS} numbers: name another topic")
    for column in kept.values():
        column.extend([math.nan] * (len(stamps) - len(column)))
    joint = next(iter(joints)) if joint is None and alone and len(joints) == 1 else joint
    paths = list(map(written, kept)) if joint is None else _without(joint, list(kept))
    return Columns(read, stamps, dict(map(_column, paths, kept.values())), joint, list(joints))


def written(path: Sequence[str]) -> str:
    """Return a path as a user types it, such as "wrench.torque.z" or "q[2]"."""
    return ".".join(path).replace(".[", "[")


def names_of(fields: Iterable[Any]) -> dict[int, tuple[str, ...]]:
    """Return the lists of names among the fields of a row, by length. Lists of the same length are joined name
    by name.
    """
    found: dict[int, tuple[str, ...]] = {}
    for value in fields:
        if _is_names(value):
            others = found.get(len(value))
            pairs = zip(value if others is None else others, value, strict=True)
            found[len(value)] = tuple(value) if others is None else tuple(map("|".join, pairs))
    return found


def _is_names(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, str) for item in value)


def _without(joint: str, paths: Sequence[tuple[str, ...]]) -> list[str]:
    """Return the paths of one joint's values without the joint's name, shortened to the last part where that is
    unique.
    """
    left = [tuple(part for part in path if part != joint) or path for path in paths]
    lasts = [path[-1] for path in left]
    return [path[-1] if lasts.count(path[-1]) == 1 else written(path) for path in left]


def _values(path: tuple[str, ...], named: tuple[str, ...], value: Any, beside: Names) -> Iterator[Value]:
    """Yield the values of a row or of a part of it. beside: the names in this part and in the parts around it."""
    if isinstance(value, np.ndarray | list | tuple):
        yield from _elements(path, named, value, beside)
    elif (fields := _fields(value)) is None:
        yield Value(path, value, named)
    elif "value" in fields and len(fields) == 2 and {*fields} & {*_NAMING}:  # a KeyValue has its number as a text
        with suppress(ValueError, TypeError):
            yield Value(path, float(fields["value"]), named)
    else:
        beside = {**beside, **names_of(fields.values())}
        for name, item in fields.items():
            if not _is_names(item):
                yield from _values((*path, name), named, item, beside)


def _fields(value: Any) -> Mapping[str, Any] | None:
    """Return the fields of an object or a message, None for a value."""
    if isinstance(value, Mapping):
        return value
    known = getattr(value, "__dataclass_fields__", None)
    return None if known is None else {name: getattr(value, name) for name in known if name not in _NOT_READ}


def _elements(path: tuple[str, ...], named: tuple[str, ...], values: Any, beside: Names) -> Iterator[Value]:
    names = _own_names(values) or beside.get(len(values))
    if names:
        for name, item in zip(names, values, strict=True):
            if names.count(name) == 1:  # which of two is meant is not known
                yield from _values((*path, name), (*named, name), item, beside)
    elif len(values) <= _MOST_VALUES:
        for index, item in enumerate(values):
            yield from _values((*path, f"[{index}]"), named, item, beside)


def _own_names(values: Any) -> tuple[str, ...]:
    """Return the names of the objects in a list, such as "motor 1" of a DiagnosticStatus; () unless each has a name."""
    parts = [_fields(item) or {} for item in values] if isinstance(values, list) else []
    for field in _NAMING:
        found = tuple(str(part[field]) for part in parts if isinstance(part.get(field), str | int))
        if len(found) == len(parts) and all(found):
            return found
    return ()


def _column(path: str, values: Sequence[Any]) -> tuple[str, NDArray[Any]]:
    """Return the heading of a column and its values (n,): numbers; dates and times, also as text in ISO 8601, in s; or
    else texts.
    """
    if isinstance(values, array):
        return path, np.array(values)
    first = next((one for one in values if not isinstance(one, float)), None)
    if seconds(first) is not None:
        stamps = map(seconds, values)
        return f"{path} [s]", np.array([math.nan if one is None else one for one in stamps])
    return path, np.array(["" if one is None or one != one else str(one) for one in values])  # noqa: PLR0124 - NaN
