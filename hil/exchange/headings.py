"""Headings of a table: a column's name with the unit in it: "tau [mN m]", "dtheta/rad", "time_ms", "angleDeg"."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

from hil import units
from hil.errors import WrongUse
from hil.recording.channels import CHANNELS

_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\{([^{}]*)\}|<([^<>]*)>|\(([^()]*(?:\([^()]*\))?)\)")
_SEPARATED = re.compile(r"\s*/\s*|\s*[,;:]\s+|[\s_]+in[\s_]+|[\s_.:-]+")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_SHOWN = 40  # names in a message
_PREFIXES = "mcukn"
_NAMED = re.compile(r"^(?:time|timestamp|torque|angle|position|velocity)(?=[a-zA-Z])", re.IGNORECASE)


def heading(channel: str) -> str:
    """Return the heading of a channel in an exported table, such as "torque [N*m]"."""
    return f"{channel} [{CHANNELS[channel].unit}]"


def listed(titles: Sequence[str]) -> str:
    """Return the headings as a list for a message; only the first ones if there are many."""
    more = f" and {len(titles) - _SHOWN} more" if len(titles) > _SHOWN else ""
    return ", ".join(titles[:_SHOWN]) + more


def names(title: str) -> list[str]:
    """Return the names by which a column can be found apart from its whole heading: the heading without the unit."""
    ends = [name for name, unit in _at_the_end(title) if name and is_unit(unit)]
    return list(dict.fromkeys([*(name for name, _ in _in_brackets(title)), *ends]))


def unit_of(title: str, dimension: str) -> str | None:
    """Return the unit of `dimension` in a heading, None if the heading has no unit.

    Raises WrongUse if the heading has two different units, or has in brackets a unit of another dimension.
    """
    bracketed = [unit for _, unit in _in_brackets(title)]
    plain = _BRACKETS.sub("", title).strip()
    stated = [unit for unit in bracketed if units.known(dimension, unit) is not None]
    ends = [unit for _, unit in _at_the_end(plain) if units.known(dimension, unit) is not None]
    for unit in bracketed if not stated else ():
        others = [one for one in units.SI if units.known(one, unit) is not None]
        if others:
            raise WrongUse(
                f"column {title!r} is {_a(others[0])} by its heading, not {_a(dimension)}: name another column"
            )
    found = stated + ends[:1]  # the longest end first: "rad/s", not "s"
    factors = [units.factor(dimension, unit) for unit in found]
    if found and not math.isclose(min(factors), max(factors), rel_tol=1e-9):
        raise WrongUse(f"column {title!r} states two units, {' and '.join(found)}: correct the heading")
    return found[0] if found else None


def bracketed_text(title: str) -> str | None:
    """Return the text in the brackets of a heading, whether or not it is a unit; None without brackets."""
    found = [text for _, text in _in_brackets(title) if text]
    return found[0] if found else None


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of any dimension."""
    return any(units.known(dimension, text) is not None for dimension in units.SI)


def _in_brackets(title: str) -> Iterator[tuple[str, str]]:
    for match in _BRACKETS.finditer(title):
        name = (title[: match.start()] + title[match.end() :]).strip()
        if name:
            yield name.rstrip("/_ "), next(text for text in match.groups() if text is not None).strip()


def _at_the_end(title: str) -> Iterator[tuple[str, str]]:
    """Yield each way to split a heading into a name and, at its end, a possible unit; the longest unit first."""
    yield "", title.strip()
    for match in _SEPARATED.finditer(title):
        yield title[: match.start()].strip(), title[match.end() :].strip()
    for match in _CAMEL.finditer(title):
        name, end = title[: match.start()], title[match.start() :]
        if name[-1] not in _PREFIXES or not is_unit(name[-1] + end):
            yield name, end  # but not the Nm of "taumNm"
            yield name, end.lower() if re.fullmatch(r"[A-Z][a-z]+", end) else end
    for match in _NAMED.finditer(title):
        yield match[0], title[match.end() :]


def _a(dimension: str) -> str:
    return f"{'an' if dimension[0] in 'ai' else 'a'} {dimension}"
