"""Read the table.toml of a drive family: registers, models, messages and error texts."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def table(family: str, package: str = "drivers") -> dict[str, Any]:
    """Return the contents of the file table.toml in the folder `family` of `package`. The file's first lines name its
    sources.
    """
    return tomllib.loads(files(package).joinpath(family, "table.toml").read_text(encoding="utf-8"))


def texts_of(bits: int, texts: dict[int, str]) -> str:
    """Return one text for the error word `bits`: the text of each set bit that is in `texts`, and the number of the
    unknown bits.
    """
    known = [text for bit, text in texts.items() if bits & bit]
    unknown = bits & ~sum(texts)
    return "; ".join([*known, *([f"unknown error bits 0x{unknown:x}: see the vendor's manual"] if unknown else [])])
