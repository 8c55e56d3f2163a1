"""The file of --faults: a plan of faults in TOML, checked, each error with its line and key."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from hil.errors import WrongUse
from hil.recording.input import read_text
from hil.stand.sentences import names_the_value, sentence
from sim_backend.fault_plan import KINDS, FaultPlan, PlannedFault

_LARGEST = 1 << 20  # bytes
Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Fault(_Table):
    """[[fault]]: kind, one of at (s), frame (number) and probability, and duration (s) or count (frames); size."""

    kind: str
    at: NotNegative | None = None
    frame: Annotated[int, Field(ge=1)] | None = None
    probability: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    duration: NotNegative | None = None
    count: Annotated[int, Field(ge=1)] = 1
    size: Finite | None = None

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in KINDS:
            raise ValueError(f"there is no kind {kind!r}: known are {', '.join(KINDS)}")
        return kind

    @model_validator(mode="after")
    def _once(self) -> _Fault:
        if sum(value is not None for value in (self.at, self.frame, self.probability)) != 1:
            raise ValueError("give one of at (s), frame (number of the reply) and probability (of each reply)")
        if self.duration is not None and self.at is None:
            raise ValueError("duration (s) goes with at; with frame, give count")
        return self

    def planned(self) -> PlannedFault:
        """Return the fault."""
        given = {name: value for name, value in self.model_dump().items() if value is not None}
        return PlannedFault(**given)


class _File(_Table):
    seed: Annotated[int, Field(ge=0)] = 0
    fault: Annotated[list[_Fault], Field(min_length=1)]


def load_plan(path: Path) -> FaultPlan:
    """Return the plan in a file. Raises WrongUse with every error of it, each with its line and key."""
    text = read_text(path, largest=_LARGEST)
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise WrongUse(f"{path} is not TOML: {error}") from None
    try:
        file = _File.model_validate(table)
    except ValidationError as error:
        errors = [_message(text, item) for item in error.errors()]
        raise WrongUse(f"{path} has {len(errors)} error(s):\n" + "\n".join(f"  {one}" for one in errors)) from None
    return FaultPlan([fault.planned() for fault in file.fault], file.seed)


def _message(text: str, item: Any) -> str:
    place = [part for part in item["loc"] if isinstance(part, str | int)]
    number = next((part for part in place if isinstance(part, int)), None)
    key = str(place[-1]) if place and isinstance(place[-1], str) else "fault"
    value = f"{item['input']!r} " if names_the_value(item) else ""
    return f"line {_line(text, number, key)}: {key}: {value}{sentence(item)}"


def _line(text: str, number: int | None, key: str) -> int:
    """Return the line, from 1, of `key` in the [[fault]] of that number, from 0; of the table where there is none."""
    lines = text.splitlines()
    heads = [place for place, line in enumerate(lines) if re.match(r"\s*\[\[\s*fault\s*\]\]", line)]
    first, last = 0, len(lines)
    if number is not None and number < len(heads):
        first, last = heads[number], (*heads, len(lines))[number + 1]
    pattern = re.compile(rf"""\s*["']?{re.escape(key)}["']?\s*=""")
    return 1 + next((place for place in range(first, last) if pattern.match(lines[place])), first)
