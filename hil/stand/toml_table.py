"""Read a TOML file that a person writes as a checked table; every error is reported with its line and key."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from hil.errors import WrongUse, decimal_comma
from hil.quantities import in_si
from hil.recording.input import read_text

_LARGEST = 1 << 20  # bytes
LISTED = 20
"""The largest number of errors that a message lists."""
_LONGEST = 220  # characters of one
_HEADER = re.compile(r"\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(#.*)?$")

Table = TypeVar("Table", bound=BaseModel)


def load_table(path: Path, kind: type[Table], message: Callable[[str, Any], str]) -> Table:
    """Return the table of class `kind` in a TOML file. Raises WrongUse with all errors of the file.

    message: function that makes one line of the message from the text of the file and an entry of a ValidationError's
    `errors()`.
    """
    text = read_text(path, largest=_LARGEST)
    table = parsed(text, path)
    values, wrong = in_si(table, kind)
    items: list[Any] = [{"type": "value_error", "loc": at, "ctx": {"error": said}} for at, said in wrong.items()]
    try:
        checked = kind.model_validate(values)
    except ValidationError as error:
        items += [item for item in error.errors() if item["loc"] not in wrong]
    if items:
        raise errors_in(path, [message(text, item) for item in items[:LISTED]], len(items))
    return checked


def parsed(text: str, name: object) -> dict[str, Any]:
    """Return the tables in the text of the TOML file `name`. Raises WrongUse."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise WrongUse(f"{name} is nested too deeply: it has tables of plain values") from None
    except ValueError as error:  # of TOML, or of an integer of thousands of digits
        at = re.search(r"at line (\d+)", str(error))
        line = text.splitlines()[int(at[1]) - 1] if at else ""
        if comma := decimal_comma(line.partition("#")[0]):
            raise WrongUse(f"{name}, line {at and at[1]}: {line.strip()!r}{comma}") from None
        raise WrongUse(f"{name} is not TOML: {error}") from None


def errors_in(name: object, lines: list[str], count: int) -> WrongUse:
    """Return the WrongUse for a file that has `count` errors.

    lines: the first `LISTED` errors, each a sentence with its line. Not more, because the line of each error is
    searched in the whole file, which may have a hundred thousand errors.
    """
    cut = [line if len(line) <= _LONGEST else f"{line[:_LONGEST]}..." for line in lines]
    more = [f"and {count - len(lines)} more"] if count > len(lines) else []
    return WrongUse(f"{name} has {count} error(s):\n" + "\n".join(f"  {line}" for line in [*cut, *more]))


def line_of(text: str, place: list[Any]) -> int:
    """Return the line number, from 1, of a key in TOML. place: the path of the key, such as ["joint", 2, "stand"]. If
    the key is missing, return the line of its table.
    """
    names = [str(part) for part in place if isinstance(part, str)]
    number = place[1] if len(place) > 1 and isinstance(place[1], int) else 0
    counts: dict[str, int] = {}
    here: list[str] = []
    found, is_it = 1, True
    for at, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            here = _keys(header[2])
            if header[1] == "[[":
                counts[here[0]] = counts.get(here[0], -1) + 1
            is_it = here == names[: len(here)] and counts.get(here[0], 0) == number
            found = at if is_it else found
        elif is_it and "=" in line and (keys := [*here, *_keys(line.partition("=")[0])]) == names[: len(keys)]:
            if len(keys) == len(names) or "{" in line:
                return at
            found = at
    return found


def _keys(dotted: str) -> list[str]:
    return [part.strip(" \"'") for part in dotted.split(".")]
