"""The tables of the drive families: registers, models, messages and error texts as data."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def table(family: str, package: str = "drivers") -> dict[str, Any]:
    """Return the table.toml in the folder `family` of `package`; its head names its sources."""
    return tomllib.loads(files(package).joinpath(family, "table.toml").read_text(encoding="utf-8"))


def texts_of(bits: int, texts: dict[int, str]) -> str:
    """Return the texts of the error bits that are set, by bit, and of those that have none."""
    known = [text for bit, text in texts.items() if bits & bit]
    unknown = bits & ~sum(texts)
    return "; ".join([*known, *([f"unknown error bits 0x{unknown:x}: see the vendor's manual"] if unknown else [])])
