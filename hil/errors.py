"""The errors with which a command ends without a result; drives have their own errors
(`drivers.servo.DriverError`).
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

_DECIMAL_COMMA: Final = re.compile(r"(?<![\w.,])([-+]?\d+),(\d+)(?![\d.,])")
_NO_MORE: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN})  # open files, memory, processes
_LISTED: Final = re.compile(r"'([^']*)' is not (?:known: choose )?one of (.+)$")


class WrongUse(Exception):
    """The request cannot be carried out: the message says what is wrong, where, and what to do (exit status 2)."""


class Declined(WrongUse):
    """A person was asked whether the motor may move, and did not agree."""


class Untrustworthy(Exception):
    """The data was read, but no result from this data could be trusted (exit status 1)."""


class InternalError(Exception):
    """hil itself failed: neither the request nor the data is the cause (exit status 70). `__cause__` is the error."""


def is_shortage(error: BaseException | None) -> bool:
    """Return whether an error, or the error that caused it, says that the computer has no more open files, memory,
    processes or threads for hil.
    """
    if error is None:
        return False
    is_thread = isinstance(error, RuntimeError) and str(error) == "can't start new thread"
    is_short = isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _NO_MORE)
    return is_short or is_thread or is_shortage(error.__cause__)


def unknown(what: str, name: str, known: Iterable[str], more: str = "") -> WrongUse:
    """Return the error for an unknown name: the message proposes the most similar known name and lists all known names.

    what: the kind of thing that is named. more: the end of the sentence.
    """
    names = list(known)
    return WrongUse(f"unknown {what} {name!r}: {meant(name, names)}known are {', '.join(names)}{more}")


def meant(name: str, known: Iterable[str]) -> str:
    """Return "did you mean 'X'? " with the most similar known name, upper or lower case; "" if no known name is
    similar.
    """
    names = {one.casefold(): one for one in known}
    near = get_close_matches(name.casefold(), names, n=1)
    return f"did you mean {names[near[0]]!r}? " if near else ""


def decimal_comma(text: str) -> str:
    """Return " has a decimal comma: write 0.5" for a text such as "0,5", and "" for a text without a decimal comma."""
    found = _DECIMAL_COMMA.search(text)
    return "" if found is None else f" has a decimal comma: write {found[1]}.{found[2]}"


def proposing(message: str) -> str:
    """Return `message`, another program's text that lists the allowed values, with the most similar allowed value
    appended.
    """
    found = _LISTED.search(message)
    if found is None:
        return message
    names = [name.strip(" .'\"") for name in found[2].split(",")]
    near = meant(found[1], names).rstrip()
    return f"{message.rstrip('.')}; {near}" if near else message
