"""The two errors with which a command refuses; drives have their own (`drivers.servo.DriverError`)."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

_LISTED: Final = re.compile(r"'([^']*)' is not (?:known: choose )?one of (.+)$")


class WrongUse(Exception):
    """The request cannot be carried out: the message says what is wrong, where, and what to do (exit status 2)."""


class Untrustworthy(Exception):
    """The data is there and was read, but no result drawn from it could be trusted (exit status 1)."""


def unknown(what: str, name: str, known: Iterable[str], more: str = "") -> WrongUse:
    """Return the error for a name that is none of those known: it proposes the nearest and lists all.

    more: the end of the sentence.
    """
    names = list(known)
    return WrongUse(f"unknown {what} {name!r}: {meant(name, names)}known are {', '.join(names)}{more}")


def meant(name: str, known: Iterable[str]) -> str:
    """Return "did you mean 'X'? " for the nearest of the names known, in any case; "" if none is near."""
    names = {one.casefold(): one for one in known}
    near = get_close_matches(name.casefold(), names, n=1)
    return f"did you mean {names[near[0]]!r}? " if near else ""


def proposing(message: str) -> str:
    """Return another program's message that lists the allowed values, with the nearest of them appended."""
    found = _LISTED.search(message)
    if found is None:
        return message
    names = [name.strip(" .'\"") for name in found[2].split(",")]
    near = meant(found[1], names).rstrip()
    return f"{message.rstrip('.')}; {near}" if near else message
