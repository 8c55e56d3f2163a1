"""Texts that come from files: safe on a terminal, in a page, and in a command that a person copies."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from unicodedata import category

_UNUSUAL = re.compile(r"[^\n\t -~]")
_STEERING = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})  # Unicode's controls, formats, surrogates, separators of lines


def printable(text: str) -> str:
    """Return text with its control characters escaped, except line ends and tabs.

    Names and messages may come from other people's files: an escape sequence in such a text could rewrite the screen,
    and a mark of text direction could reverse the words of a page.
    """
    return _UNUSUAL.sub(lambda found: _escaped(found[0]), text)


def quoted(name: str | Path) -> str:
    """Return a name as one word of a shell's command, also if it has spaces or other characters that a shell
    interprets, or if it is a path that looks like an option.
    """
    word = str(name)
    return shlex.quote(f"./{word}" if isinstance(name, Path) and word.startswith("-") else word)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode() if category(character) in _STEERING else character
