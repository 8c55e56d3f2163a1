"""Columns from the numbers in messages: each number has a path, of fields and of the names that stand beside values.

The order of the joints in a message changes from start to start. So where a list of names stands beside the values, as
in a DynamicJointState, a number is found by its name; it has no index.
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

Array = NDArray[np.float64]
Names = Mapping[int, tuple[str, ...]]  # the names beside values, by their number

_MOST_NUMBERS = 64  # of one array without names
_MOST_COLUMNS = 10_000
_NAMING = ("name", "key", "child_frame_id")  # fields with the name of the message that they are in
_NOT_READ = frozenset({"__msgtype__", "header"})


class Number(NamedTuple):
    """A number in a message. path: the fields and names that lead to it. named: the names among them."""

    path: tuple[str, ...]
    value: float
    named: tuple[str, ...]


class Columns(NamedTuple):
    """The numbers in messages. read: the number of messages. stamps: of those with numbers, ns. numbers: the columns by
    path, (n,) each. joint: the name left out of the paths. joints: the outermost names in all paths.
    """

    read: int
    stamps: Sequence[int]
    numbers: dict[str, Array]
    joint: str | None
    joints: list[str]


def columns(source: str, messages: Iterable[tuple[int, Any]], joint: str | None, *, alone: bool = False) -> Columns:
    """Return the numbers in the messages as columns. A number that a message lacks is NaN.

    messages: each with its stamp, ns. joint: only numbers with this name in their path are returned, from the messages
    that have any; a path is then its last part alone, as far as that is unique. alone: the same for the only name, if
    there is one name. Raises WrongUse for more than 10,000 columns.
    """
    stamps, kept, joints, read = array("q"), dict[tuple[str, ...], "array[float]"](), dict[str, None](), 0
    for stamp, message in messages:
        read += 1
        numbers = list(_numbers((), (), message, {}))
        joints.update((one.named[0], None) for one in numbers if one.named)
        if joint is not None and not (numbers := [one for one in numbers if joint in one.named]):
            continue
        for one in numbers:
            values = kept.setdefault(one.path, array("d"))
            values.extend([math.nan] * (len(stamps) - len(values)))
            values.append(one.value)
        stamps.append(stamp)
        if len(kept) > _MOST_COLUMNS:
            raise WrongUse(f"{source}: the messages hold more than {_MOST_COLUMNS} numbers: name another topic")
    for values in kept.values():
        values.extend([math.nan] * (len(stamps) - len(values)))
    joint = next(iter(joints)) if joint is None and alone and len(joints) == 1 else joint
    paths = [".".join(path) for path in kept] if joint is None else _without(joint, list(kept))
    return Columns(read, stamps, dict(zip(paths, map(np.array, kept.values()), strict=True)), joint, list(joints))


def _without(joint: str, paths: Sequence[tuple[str, ...]]) -> list[str]:
    """Return the paths of one joint's numbers without its name: the last part of each, as far as that is unique."""
    left = [tuple(part for part in path if part != joint) or path for path in paths]
    lasts = [path[-1] for path in left]
    return [path[-1] if lasts.count(path[-1]) == 1 else ".".join(path) for path in left]


def _numbers(path: tuple[str, ...], named: tuple[str, ...], value: Any, beside: Names) -> Iterator[Number]:
    """Yield the numbers of a message or of a part of it. beside: the names in this message and those it is part of."""
    if isinstance(value, bool | int | float | np.number):
        yield Number(path, float(value), named)
    elif isinstance(value, np.ndarray | list):
        yield from _elements(path, named, value, beside)
    elif fields := set(getattr(value, "__dataclass_fields__", ())) - _NOT_READ:
        if "value" in fields and len(fields) == 2 and fields & set(_NAMING):  # a KeyValue has its number as a text
            with suppress(ValueError, TypeError):
                yield Number(path, float(value.value), named)
            return
        beside = {**beside, **_names(getattr(value, name) for name in fields)}
        for name in value.__dataclass_fields__:
            if name in fields:
                yield from _numbers((*path, name), named, getattr(value, name), beside)


def _elements(path: tuple[str, ...], named: tuple[str, ...], values: Any, beside: Names) -> Iterator[Number]:
    names = _own_names(values) or beside.get(len(values))
    if names:
        for name, item in zip(names, values, strict=True):
            if names.count(name) == 1:  # which of two is meant is not known
                yield from _numbers((*path, name), (*named, name), item, beside)
    elif len(values) <= _MOST_NUMBERS:
        for index, item in enumerate(values):
            yield from _numbers((*path[:-1], f"{path[-1]}[{index}]"), named, item, beside)


def _own_names(values: Any) -> tuple[str, ...]:
    """Return the names of messages in a list that have each their own: "motor 1" of a DiagnosticStatus; else none."""
    for field in _NAMING:
        found = tuple(getattr(item, field, None) for item in values) if isinstance(values, list) else ()
        named = tuple(one for one in found if isinstance(one, str) and one)
        if named and len(named) == len(found):
            return named
    return ()


def _names(values: Iterable[Any]) -> dict[int, tuple[str, ...]]:
    """Return the lists of names among the fields of a message; of lists with as many names, each with all its names."""
    found: dict[int, tuple[str, ...]] = {}
    for value in values:
        if isinstance(value, list) and value and all(isinstance(item, str) for item in value):
            others = found.get(len(value))
            pairs = zip(value if others is None else others, value, strict=True)
            found[len(value)] = tuple(value) if others is None else tuple(map("|".join, pairs))
    return found
