"""What an identification found, as the report reads it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ga.trials.trials import Trials
from hil.diagnostics import Diagnostic
from hil.identification.model_choice import Coupling
from hil.identification.stepwise import Rung
from hil.signals.prepare import Signals
from hil.uncertainty.pooling import Scatter


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter in SI. value: of the best trial. exact: of the exact optimum. ci95: around the exact optimum.

    trials_std: NaN for a single trial. bounds: NaN where the parameter was solved for and not searched.
    scatter: within and between pooled recordings, None for one, or where fewer than two tell it.
    """

    name: str
    unit: str
    value: float
    exact: float
    ci95: tuple[float, float]
    trials_mean: float
    trials_std: float
    identifiable: bool
    at_bound: str | None
    bounds: tuple[float, float]
    scatter: Scatter | None = None


@dataclass(frozen=True, slots=True)
class Holdout:
    """A fit to four fifths of the run, judged on the rest.

    fitness: mean |error|, N m. nrmse: RMS error over the torque's spread, NaN where it has none.
    """

    fitness: float
    nrmse: float


@dataclass(frozen=True, slots=True)
class Fixture:
    """What held the joint, by a recording of the empty rig: its Kc and Bc, which are taken off those of the result."""

    recording: Path
    model: str
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True, slots=True)
class Identification:
    """What `hil identify` found. fitness and optimum: N m. relative_gap: the search's own error, as a ratio.

    rungs: the ladder that the model was chosen from, none where it was named. seconds: all of it; search_seconds: the
    trials alone. fixture: whose compliance was taken off, None where it counts as rigid.
    """

    recordings: tuple[Path, ...]
    model: Coupling
    rungs: tuple[Rung, ...]
    preset: str
    seed: int
    estimates: tuple[Estimate, ...]
    fitness: float
    optimum: float
    relative_gap: float
    samples: int
    trials: Trials
    seconds: float
    search_seconds: float
    holdout: Holdout
    diagnostics: tuple[Diagnostic, ...]
    signals: Signals
    fixture: Fixture | None = None

    def __getitem__(self, name: str) -> Estimate:
        return next(estimate for estimate in self.estimates if estimate.name == name)

    @property
    def trustworthy(self) -> bool:
        """Whether there is no error among the diagnostics."""
        return not any(diagnostic.is_error for diagnostic in self.diagnostics)
