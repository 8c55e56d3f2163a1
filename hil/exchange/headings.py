"""Headings of a table: a column's name with the unit in it: "tau [mN m]", "dtheta/rad", "time_ms", "angleDeg"."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType

from hil import units
from hil.errors import WrongUse
from hil.recording.channels import CHANNELS

_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\{([^{}]*)\}|<([^<>]*)>|\(([^()]*(?:\([^()]*\))?)\)")
_INDEX = re.compile(r"[\d:, ]+")  # of a column in a matrix, "q[:,2]" or "q(:,3)"
_WIDE = str.maketrans("\uff08\uff09\uff3b\uff3d", "()[]")  # as wide as a Chinese character
_PREFIXED = re.compile(r"(?:milli|micro|nano|centi|kilo|mega)[\s_-]*$", re.IGNORECASE)
_SEPARATED = re.compile(r"(?P<stated>(?<!^)\s*/\s*|\s*[,;:]\s+|[\s_]+in[\s_]+)|(?P<joined>[\s_.:-]+)")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_SHOWN = 40  # names in a message
_PREFIXES = "mcukn"
_NAMED = re.compile(r"^(?:time|timestamp|torque|angle|position|velocity)(?=[a-zA-Z]{2})", re.IGNORECASE)
_NO_UNITS = re.compile(r"(?<![a-z])(?:rotation|cycles?|num)(?![a-z])", re.IGNORECASE)  # they say what moves
_NAME = re.compile(
    r"(?:milli|micro|nano|centi|kilo)?"
    r"(?:second|minute|hour|day|degree|radian|turn|revolution|rotation|newton|met[er]{2}|inche?|foot|feet|pound|ounce|gram)",
    re.IGNORECASE,
)
_WORDS = frozenset({"min", "rev", "in", "h", "hr"})  # of other meaning too: the least, the reverse, ...
_MARKS: Mapping[str, set[str]] = MappingProxyType({"s": {"in", "_", " "}, "d": {"in"}})  # before a unit of one letter
_SIMPLE = frozenset({"time", "angle"})  # no product of other units: "gm/ns" would be a time
_RARER: Mapping[str, tuple[str, ...]] = MappingProxyType({"time": ("h", "d"), "angle": ("arcmin", "arcsec")})


def heading(channel: str) -> str:
    """Return the heading of a channel in an exported table, such as "torque [N*m]"."""
    return f"{channel} [{CHANNELS[channel].unit}]"


def listed(titles: Sequence[str]) -> str:
    """Return the headings as a list for a message; only the first ones if there are many."""
    more = f" and {len(titles) - _SHOWN} more" if len(titles) > _SHOWN else ""
    return ", ".join(titles[:_SHOWN]) + more


@lru_cache(maxsize=4096)
def names(title: str) -> tuple[str, ...]:
    """Return the names by which a column can be found apart from its whole heading: the heading without the unit."""
    ends = [name for name, text, mark in _at_the_end(title) if name and _dimensions(text, mark, name)]
    return tuple(dict.fromkeys([*(name for name, _ in _in_brackets(title)), *ends]))


def unit_of(title: str, dimension: str) -> str | None:
    """Return the unit of `dimension` in a heading, None if the heading has no unit.

    A unit counts in brackets, after a comma, a slash or "in", and at the end of the heading if it is a symbol of the
    dimension. An English word at the end is a name: "knee rotation". Raises WrongUse if the heading has two different
    units, or has in brackets a unit of another dimension.
    """
    bracketed = [unit for _, unit in _in_brackets(title)]
    plain = _BRACKETS.sub("", title.translate(_WIDE)).strip()
    stated = [unit for unit in bracketed if _is_of(dimension, unit)]
    ends = next((one for name, *end in _at_the_end(plain) if (one := _dimensions(end[0], end[1], name))), {})
    for unit in () if stated else bracketed:
        others = [one for one in units.SI if _counts(one, unit, "_")]
        if others:
            raise WrongUse(
                f"column {title!r} is {_a(others[0])} by its heading, not {_a(dimension)}: name another column"
            )
    found = stated + ([ends[dimension]] if dimension in ends else [])
    factors = [units.factor(dimension, unit) for unit in found]
    if found and not math.isclose(min(factors), max(factors), rel_tol=1e-9):
        raise WrongUse(f"column {title!r} states two units, {' and '.join(found)}: correct the heading")
    return found[0] if found else None


def bracketed_text(title: str) -> str | None:
    """Return the text in the brackets of a heading, whether or not it is a unit; None without brackets."""
    found = [text for _, text in _in_brackets(title) if text]
    return found[0] if found else None


def is_unit(text: str) -> bool:
    """Return whether a text that stands where a unit is expected is a unit of any dimension."""
    return any(_is_of(dimension, text) for dimension in _DIMENSIONS)


_DIMENSIONS = (*units.SI, *units.LEVER, "current", "voltage")


@lru_cache(maxsize=4096)
def _is_of(dimension: str, text: str) -> bool:
    """Return whether a text in brackets is a unit of a dimension. A text that may be a word counts only if the unit is
    common: "gin" and "inn" could mean g*in and in*N.
    """
    is_product = dimension in _SIMPLE and not (text.isalpha() or text in {"°", "º"})
    factor = None if is_product or _NO_UNITS.search(text) else units.known(dimension, text)
    may_be_word = text.isalpha() and text in {text.lower(), text.title(), text.upper()}
    return factor is not None and (not may_be_word or _is_usual(dimension, factor))


def _is_usual(dimension: str, factor: float) -> bool:
    usual = units.COMMON[dimension] + _RARER.get(dimension, ())
    return any(math.isclose(factor, units.factor(dimension, one), rel_tol=1e-9) for one in usual)


@lru_cache(maxsize=4096)
def _counts(dimension: str, text: str, mark: str) -> bool:
    """Return whether the end of a heading is a unit of a dimension.

    mark: what stands before the unit: "in" for a comma, a slash or "in"; "_"; " " for any other separator; "" for none.
    A name of a unit counts only in the plural, and never after a space. A symbol with another meaning ("time min")
    counts only after "in".
    """
    for word in _NAME.finditer(text):
        after_per = re.search(r"(?:per|/)[\s_]*$", text[: word.start()]) is not None
        if not after_per and (mark in {" ", ""} or text[word.end() : word.end() + 1].lower() not in {"s", "e"}):
            return False
    if (mark != "in" and text.lower() in _WORDS) or (mark == " " and text == "us"):
        return False
    if len(text) == 1 and mark not in _MARKS.get(text.lower(), {"in", "_"}):
        return False
    return _is_of(dimension, text) and (mark == "in" or _is_usual(dimension, units.factor(dimension, text)))


def _dimensions(text: str, mark: str, name: str) -> dict[str, str]:
    """Return, for each dimension of which the end `text` of a heading is a unit, this text.

    mark, name: the separator and the text before the end; after "milli" the end is only a part of a unit.
    """
    return {} if _PREFIXED.search(name) else {one: text for one in _DIMENSIONS if _counts(one, text, mark)}


def _in_brackets(title: str) -> Iterator[tuple[str, str]]:
    title = title.translate(_WIDE)
    for match in _BRACKETS.finditer(title):
        name = (title[: match.start()] + title[match.end() :]).strip()
        text = next(text for text in match.groups() if text is not None).strip()
        is_index = _INDEX.fullmatch(text) and not title[: match.start()].endswith(" ")
        if name and not is_index:
            yield name.rstrip("/_ "), text


def _at_the_end(title: str) -> Iterator[tuple[str, str, str]]:
    """Yield each way to split a heading into a name, a possible unit at its end, and the mark of the separator between
    them; the longest unit first.
    """
    yield "", title.strip(), "_"
    for match in _SEPARATED.finditer(title):
        mark = "in" if match["stated"] else "_" if "_" in match[0] else " "
        yield title[: match.start()].strip(), title[match.end() :].strip(), mark
    for match in _CAMEL.finditer(title):
        name, end = title[: match.start()], title[match.start() :]
        if name[-1] not in _PREFIXES or not is_unit(name[-1] + end):
            yield name, end, ""  # but not the Nm of "taumNm"
            yield name, end.lower() if re.fullmatch(r"[A-Z][a-z]+", end) else end, ""
    for match in _NAMED.finditer(title):
        yield match[0], title[match.end() :], ""


def _a(dimension: str) -> str:
    return f"{'an' if dimension[0] in 'ai' else 'a'} {dimension}"
