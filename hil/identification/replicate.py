"""The paper's experiment from end to end on the simulated stand: 2,500 samples, 30 trials, Table 1 and Figure 8."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.servo import Quantity
from ga.evolution.evolution import PRESETS
from ga.fitness.engine import REPAID, WORTHWHILE
from ga.model.terms import parse as parse_model
from hil.acquisition import excitation
from hil.acquisition.run import run
from hil.identification.disk_table import Progress
from hil.identification.identify import Search, identify
from hil.identification.result import Identification
from hil.recording.output import atomic_write, next_free
from hil.recording.reader import Recording
from hil.signals.prepare import Signals
from hil.stand.file import SIMULATED, parse

SAMPLES, RATE = 2500, 500.0
PAPER = {"Kc": (17.52e-3, 6.62e-3), "Bc": (0.19e-3, 0.075e-3)}
"""Mean and standard deviation over the paper's 30 trials, SI (its Table 1)."""

_MEASURE = 0.5  # s over which the NumPy expression is timed


@dataclass(frozen=True, slots=True)
class Replication:
    """What came of it. truth: of the simulated stand, SI. numpy_seconds: of one evaluation with NumPy, same data."""

    identification: Identification
    truth: dict[str, float]
    numpy_seconds: float
    workers: int

    @property
    def evaluations_per_second(self) -> float:
        """Fitness evaluations a second, all cores together, of the run that ended here."""
        return self.identification.trials.made / self.identification.search_seconds

    @property
    def ratio_to_numpy(self) -> float:
        """How many times faster one evaluation is, on one core, than the NumPy expression in the same process.

        By processor time: what else the machine does counts for neither.
        """
        trials = self.identification.trials
        return self.numpy_seconds * trials.made / trials.processor_seconds


def replicate(
    folder: Path,
    *,
    evaluations: int,
    trials: int,
    seed: int,
    workers: int,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
) -> Replication:
    """Record the paper's 2,500 samples into `folder` and search them as the paper did.

    evaluations: of each trial. seed: of the simulated stand and of the search. checkpoint: as of `Search`; the same
    seed records the same samples again, so that a search can be gone on with. Raises WrongUse, DriverError.
    """
    path = _record(folder, seed)
    settings = replace(PRESETS["paper"], generations=evaluations)
    workers = min(workers, trials)
    search = Search("paper", settings, trials=trials, seed=seed, workers=workers, bounds={}, checkpoint=checkpoint)
    model = parse_model("linear")
    # compiles what is timed next: as many generations as it takes to choose the same engine
    short = replace(settings, generations=min(evaluations, max(REPAID, WORTHWHILE // SAMPLES)))
    identify([path], model, replace(search, settings=short, trials=1, checkpoint=None))
    found = identify([path], model, search, progress)
    with Recording(path) as recording:
        truth = recording.truth()
    return Replication(found, truth, _numpy_seconds(found.signals), workers)


def _record(folder: Path, seed: int) -> Path:
    stand = parse(SIMULATED)
    profile = excitation.make(
        "chirp",
        Quantity.TORQUE,
        amplitude=None,
        default_amplitude=stand.checked_limits().torque / 5.0,
        duration=(SAMPLES - 1) / RATE,
        band=(0.2, 15.0),
        rate=RATE,
        fade=0.5,
        seed=seed,
    )
    path, outcome = run(
        stand,
        profile,
        rate=RATE,
        seed=seed,
        note="hil replicate",
        command_line="hil replicate",
        output=next_free(folder),
    )
    if outcome.error is not None:
        raise outcome.error
    return path


def _numpy_seconds(signals: Signals) -> float:
    """The processor time of one fitness evaluation as one writes it with NumPy, s: the best of many."""
    dtheta, rate, torque = signals.motion.dtheta, signals.motion.dtheta_dot, signals.torque
    best, end = float("inf"), time.process_time() + _MEASURE
    while time.process_time() < end:
        began = time.process_time()
        for _ in range(100):
            np.mean(np.abs(torque - (dtheta * 0.0177 + rate * 1.9e-4)))
        best = min(best, (time.process_time() - began) / 100)
    return best


def as_json(done: Replication) -> dict[str, Any]:
    """The JSON object of `hil replicate --json`, SI units."""
    found = done.identification
    return {
        "schema": "hil-replication/1",
        "recording": str(found.recordings[0]),
        "samples": found.samples,
        "trials": len(found.trials.fitness),
        "evaluations": found.trials.evaluations,
        "seconds": found.search_seconds,
        "processor_seconds": found.trials.processor_seconds,
        "workers": done.workers,
        "evaluations_per_second": done.evaluations_per_second,
        "numpy_seconds_per_evaluation": done.numpy_seconds,
        "ratio_to_numpy": done.ratio_to_numpy,
        "relative_gap": found.optimiser_gap,
        "interrupted": found.trials.interrupted,
        "parameters": {
            estimate.name: {
                "unit": estimate.unit,
                "true": done.truth[estimate.name],
                "best": estimate.optimiser.best,
                "mean": estimate.optimiser.mean,
                "std": estimate.optimiser.std if len(found.trials.fitness) > 1 else None,
                "exact": estimate.value,
                "paper_mean": PAPER[estimate.name][0],
                "paper_std": PAPER[estimate.name][1],
            }
            for estimate in found.estimates
        },
    }


def table(done: Replication) -> list[str]:
    """Table 1 beside the paper's, a line each, in mN m."""
    kc, bc = done.identification.estimates
    rows = [
        ("", "Kc [mN m/rad]", "Bc [mN m s/rad]"),
        ("real parameters (simulated stand)", f"{done.truth['Kc'] * 1e3:.2f}", f"{done.truth['Bc'] * 1e3:.3f}"),
        ("best of the trials", f"{kc.optimiser.best * 1e3:.4f}", f"{bc.optimiser.best * 1e3:.5f}"),
        (
            "trials, mean ± std",
            _spread(kc.optimiser.mean, kc.optimiser.std),
            _spread(bc.optimiser.mean, bc.optimiser.std),
        ),
        ("the paper's, mean ± std", *(_spread(*PAPER[name]) for name in ("Kc", "Bc"))),
        ("exact optimum of these data", f"{kc.value * 1e3:.4f}", f"{bc.value * 1e3:.5f}"),
    ]
    return [f"{what:36}{first:>20}{second:>22}" for what, first, second in rows]


def _spread(mean: float, std: float) -> str:
    return f"{mean * 1e3:.4g} ± {std * 1e3:.2g}"


def draw_convergence(done: Replication, path: Path) -> None:
    """Write Figure 8 as a PNG: the best fitness of every trial against the generation, above the exact optimum.

    Raises WrongUse where the file cannot be written.
    """
    from matplotlib.figure import Figure

    found = done.identification
    history = found.trials.history
    figure = Figure(figsize=(8, 5), layout="constrained")
    panels = figure.subplots(1, 2)
    generation = np.maximum(history.generation, 1)
    for fitness in history.fitness:
        panels[0].plot(generation, fitness * 1e3, lw=0.7)
        above = np.maximum(fitness / found.optimum - 1.0, 1e-16)
        panels[1].plot(generation, above, lw=0.7)
    panels[0].axhline(found.optimum * 1e3, color="k", ls="--", lw=1, label="exact optimum")
    panels[0].set(xscale="log", yscale="log", xlabel="generation", ylabel="best fitness [mN m]", title="Figure 8")
    panels[0].legend()
    panels[1].set(xscale="log", yscale="log", xlabel="generation", ylabel="above the exact optimum, relative")
    for panel in panels:
        panel.grid(visible=True, lw=0.3)
    with atomic_write(path, force=True) as temporary:
        figure.savefig(temporary, format="png", dpi=110)
