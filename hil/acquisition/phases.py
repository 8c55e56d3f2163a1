"""The phases of a run as one state machine: the allowed order, the start of each phase, and how the run ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType


class Phase(StrEnum):
    """A phase of a run. Torque may be on from ARMING on, and is off in OFF."""

    REST = "at rest"
    ARMING = "arming"
    FADE_IN = "fade-in"
    RUN = "run"
    RAMP_DOWN = "ramp-down"
    OFF = "off"
    CLOSED = "closed"


FOLLOWS: Mapping[Phase, frozenset[Phase]] = MappingProxyType(
    {
        Phase.REST: frozenset({Phase.ARMING, Phase.OFF, Phase.CLOSED}),
        Phase.ARMING: frozenset({Phase.FADE_IN, Phase.OFF, Phase.CLOSED}),
        Phase.FADE_IN: frozenset({Phase.RUN, Phase.RAMP_DOWN, Phase.OFF, Phase.CLOSED}),
        Phase.RUN: frozenset({Phase.RAMP_DOWN, Phase.OFF, Phase.CLOSED}),
        Phase.RAMP_DOWN: frozenset({Phase.OFF, Phase.CLOSED}),
        Phase.OFF: frozenset({Phase.CLOSED}),
        Phase.CLOSED: frozenset(),
    }
)
"""The phases that may follow each phase. A run that enters CLOSED without OFF before it had no confirmed torque-off."""


class Phases:
    """The phases that a run has passed through. history: each phase with its start time, s on the servo's clock."""

    def __init__(self) -> None:
        self.now = Phase.REST
        self.history: list[tuple[float, Phase]] = []

    def enter(self, phase: Phase, t: float) -> None:
        """Begin `phase` at time `t`, s. Raises ValueError if `phase` may not follow the present phase."""
        if phase not in FOLLOWS[self.now]:
            raise ValueError(f"a run cannot go from {self.now} to {phase}")
        self.now = phase
        self.history.append((t, phase))


@dataclass(slots=True)
class Outcome:
    """How a run ended.

    samples, lost, saturated: numbers of rows, of lost replies, and of rows with saturated torque. late: number of ticks
    that began more than half a period late. missed: number of late ticks that were skipped because the next tick had to
    begin. end_reason: why the run ended, for the recording. error: the fault that ended the run; None if the run was
    complete or was stopped on request. signal: number of the signal that requested the stop. alarm: a sentence to show
    first if the torque may still be on, otherwise "". moved: a sentence that says where the recording is, if its file
    was removed during the run or could not be made final. exceeded: for each limit that was exceeded beyond the noise
    without ending the run, how far and since when. neighbours: which other motor of a hand turned most, "" without one.
    phases: the phases of the run.
    """

    samples: int = 0
    lost: int = 0
    late: int = 0
    missed: int = 0
    saturated: int = 0
    end_reason: str = "done"
    signal: int = 0
    error: BaseException | None = None
    alarm: str = ""
    moved: str = ""
    exceeded: list[str] = field(default_factory=list)
    neighbours: str = ""
    phases: Phases = field(default_factory=Phases)
