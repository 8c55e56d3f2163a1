"""The file for --faults: a plan of faults in TOML. Every error in the file is reported with its line and key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from annotated_types import Unit
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from hil.errors import meant
from hil.stand.sentences import names_the_value, sentence
from hil.stand.toml_table import line_of, load_table
from sim_backend.fault_plan import KINDS, FaultPlan, PlannedFault

Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Fault(_Table):
    """A table [[fault]].

    kind: of the fault. at: start, s; or frame: start, number of a frame; or probability: of the fault in each frame.
    duration: s; or count: number of frames. size: of the fault.
    """

    kind: str
    at: Annotated[NotNegative, Unit("s")] | None = None
    frame: Annotated[int, Field(ge=1)] | None = None
    probability: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    duration: Annotated[NotNegative, Unit("s")] | None = None
    count: Annotated[int, Field(ge=1)] = 1
    size: Finite | None = None

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in KINDS:
            raise ValueError(f"there is no kind {kind!r}: {meant(kind, KINDS)}known are {', '.join(KINDS)}")
        return kind

    @model_validator(mode="after")
    def _once(self) -> _Fault:
        if sum(value is not None for value in (self.at, self.frame, self.probability)) != 1:
            raise ValueError("give one of at (s), frame (number of the reply) and probability (of each reply)")
        if self.duration is not None and self.at is None:
            raise ValueError("duration (s) can only be used with at; with frame, give count")
        self.planned()  # raises for a size that the kind cannot have
        return self

    def planned(self) -> PlannedFault:
        """Return the fault for the simulator."""
        given = {name: value for name, value in self.model_dump().items() if value is not None}
        return PlannedFault(**given)


class _File(_Table):
    seed: Annotated[int, Field(ge=0)] = 0
    fault: Annotated[list[_Fault], Field(min_length=1)]


def load_plan(path: Path) -> FaultPlan:
    """Return the plan in a file. Raises WrongUse with all errors of the file, each with its line and key."""
    file = load_table(path, _File, _message)
    return FaultPlan([fault.planned() for fault in file.fault], file.seed)


def _message(text: str, item: Any) -> str:
    place = [part for part in item["loc"] if isinstance(part, str | int)]
    key = str(place[-1]) if place and isinstance(place[-1], str) else "fault"
    value = f"{item['input']!r} " if names_the_value(item) else ""
    return f"line {line_of(text, place)}: {key}: {value}{sentence(item)}"
