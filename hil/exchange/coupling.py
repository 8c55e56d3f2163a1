"""The identified coupling for other programs: stiffness, damping and friction, from a result of `hil identify`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ga.model.terms import TERMS, of_kind, of_role
from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse
from hil.printable import quoted
from hil.recording.input import read_text
from hil.report.identification_json import upgraded

_LARGEST = 1 << 26  # bytes of a result
_REPRESENTED = frozenset(of_role("coupling", "bias", "channel")) | {name for name, one in TERMS.items() if one.bench}


@dataclass(frozen=True, slots=True)
class Coupling:
    """The identified coupling of a joint: stiffness, N m/rad, and damping, N m s/rad, with 95 % intervals; friction, N
    m (0 if the model has none). All values are at the joint.

    model: the identified terms, joined with +. parameters: value and unit of every parameter, SI. source: the
    recordings. controller: the numbers for a controller, SI, by name: value, 95 % interval (None: it was
    given) and unit.
    """

    stiffness: float
    stiffness_interval: tuple[float, float]
    damping: float
    damping_interval: tuple[float, float]
    friction: float
    model: str
    parameters: Mapping[str, tuple[float, str]]
    source: tuple[str, ...]
    controller: Mapping[str, tuple[float, tuple[float, float] | None, str]] = field(default_factory=dict)

    def left_out(self) -> list[Diagnostic]:
        """Return the warning about terms that a simulator's joint does not support: all except stiffness, damping and
        friction.
        """
        terms = unrepresented(self.model)
        if not terms:
            return []
        message = (
            f"the coupling was identified as {self.model}, and this format has no place for {', '.join(terms)}: a "
            "simulation with Kc and Bc alone differs by these; export as JSON to keep them"
        )
        return [Diagnostic("terms-left-out", message)]


def unrepresented(model: str) -> list[str]:
    """Return the terms of a model, its terms joined with +, for which a simulator's joint or tendon has no place."""
    return [term for term in model.split("+") if term not in _REPRESENTED]


def of_result(path: Path) -> Coupling:
    """Return the coupling in a file that `hil identify --json` wrote. Raises WrongUse, and Untrustworthy if Kc or Bc
    must not be trusted.
    """
    text = read_text(path, largest=_LARGEST)
    try:
        table = json.loads(text)
    except (ValueError, RecursionError):
        table = None
    if not isinstance(table, dict) or "schema" not in table:
        raise WrongUse(
            f"{path} is no result of hil identify: write one with `hil identify RECORDING --json > {quoted(path)}`"
        )
    try:
        current = upgraded(table)
    except (KeyError, TypeError, AttributeError):
        current = table  # which lacks a part
    return of_json(current, str(path))


def of_json(table: Mapping[str, Any], name: str) -> Coupling:
    """Return the coupling in the JSON object of `hil identify --json`.

    name: of the file, for messages. Raises Untrustworthy if Kc or Bc must not be trusted, WrongUse if either is
    missing.
    """
    try:
        return _of_json(table, name)
    except (KeyError, TypeError, ValueError, AttributeError):
        raise WrongUse(f"{name} lacks the value or interval of Kc or Bc: identify the recording again") from None


def _of_json(table: Mapping[str, Any], name: str) -> Coupling:
    found = table["parameters"]
    for parameter in ("Kc", "Bc"):
        if not found[parameter].get("trusted"):
            why = "".join(f": {one['message']}" for one in table["errors"][:1])
            raise Untrustworthy(f"{name}: {parameter} cannot be trusted, so no model is made of it{why}")
    friction = sum((float(found[name]["value"]) for name in of_kind(found, "dry friction")), 0.0)
    values = {key: (float(one["value"]), str(one["unit"])) for key, one in found.items() if one["value"] is not None}
    kc, bc = _with_interval(found["Kc"]), _with_interval(found["Bc"])
    numbers = {
        name: (*_with_interval(one), str(one["unit"]))
        if "ci95" in one
        else (float(one["value"]), None, str(one["unit"]))
        for name, one in (table.get("controller") or {}).items()
        if isinstance(one, dict)  # else a sentence
    }
    source = tuple(str(one) for one in table["recordings"])
    return Coupling(*kc, *bc, friction, str(table["model"]), values, source, numbers)


def _with_interval(parameter: Mapping[str, Any]) -> tuple[float, tuple[float, float]]:
    """Return value and interval of a parameter in a JSON object. Raises ValueError if any of these is not a number."""
    low, high = (float(end) for end in parameter["ci95"])
    value = float(parameter["value"])
    if not all(map(math.isfinite, (value, low, high))):
        raise ValueError
    return value, (low, high)
