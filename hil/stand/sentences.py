"""Sentences about wrong values in a stand file; they replace pydantic's own sentences."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from hil.errors import decimal_comma, meant

_SENTENCES: Mapping[str, str] = MappingProxyType(
    {
        "missing": "must be given",
        "missing_argument": "must be given",
        "extra_forbidden": "no such key",
        "unexpected_keyword_argument": "no such key",
        "value_error": "{error}",  # several keys that do not fit each other, or a unit; it names them
        "greater_than": "must be above {gt}",
        "greater_than_equal": "must be at least {ge}",
        "less_than": "must be below {lt}",
        "less_than_equal": "must be at most {le}",
        "finite_number": "must be a finite number",
        "literal_error": "must be {expected}",
        "enum": "must be {expected}",
        "float_type": "must be a number",
        "float_parsing": "must be a number",
        "int_type": "must be a whole number",
        "int_parsing": "must be a whole number",
        "int_from_float": "must be a whole number",
        "bool_type": "must be true or false",
        "bool_parsing": "must be true or false",
        "string_type": "must be a text in quotation marks",
        "model_type": "must be a table",
        "model_attributes_type": "must be a table",
        "dataclass_type": "must be a table",
        "dict_type": "must be a table",
        "list_type": "must be a list",
        "tuple_type": "must be a list",
    }
)
NO_SUCH_KEY = frozenset({"extra_forbidden", "unexpected_keyword_argument"})
"""The types of pydantic errors that mean an unknown key."""
_ABOUT_THE_KEY = NO_SUCH_KEY | {"missing", "missing_argument", "value_error"}


def sentence(item: Any) -> str:
    """Return a sentence about a wrong value. item: an entry of a ValidationError's `errors()`."""
    text = _SENTENCES.get(item["type"], "is not a value that this key can have")
    near = ""
    if item["type"].startswith("float") and (comma := decimal_comma(str(item["input"]))):
        return comma.strip()
    if item["type"] in {"literal_error", "enum"} and isinstance(item["input"], str):
        near = meant(item["input"], re.findall(r"'([^']*)'", item["ctx"]["expected"]))
    return text.format(**item.get("ctx", {})) + (f"; {near.rstrip()}" if near else "")


def names_the_value(item: Any) -> bool:
    """Return whether the wrong value must be printed before the sentence."""
    return item["type"] not in _ABOUT_THE_KEY
