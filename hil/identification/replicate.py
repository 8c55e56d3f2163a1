"""Replicate the paper's experiment on the simulated stand: 2,500 samples, 30 trials, Table 1 and Figure 8."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.servo import Quantity
from ga.evolution.evolution import PRESETS
from ga.fitness.engine import REPAID, WORTHWHILE
from ga.model.coupling import parse as parse_model
from hil.acquisition import excitation
from hil.acquisition.run import run
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.ahead import Progress
from hil.recording.output import next_free
from hil.recording.reader import Recording
from hil.signals.constants import COUPLING
from hil.signals.prepare import Signals
from hil.stand.file import SIMULATED, parse

SAMPLES, RATE = 2500, 500.0
_AMPLITUDE, _BAND = 0.2, (0.2, 15.0)  # of the limit of the torque; Hz
PAPER = {"Kc": (17.52e-3, 6.62e-3), "Bc": (0.19e-3, 0.075e-3)}
"""Mean and standard deviation of each parameter over the paper's 30 trials, SI (Table 1 of the paper)."""

_MEASURE = 0.5  # s over which the NumPy expression is timed


@dataclass(frozen=True, slots=True)
class Replication:
    """The result of the replication. truth: the parameters of the simulated stand, SI. numpy_seconds: the time of one
    fitness evaluation with NumPy on the same data.
    """

    identification: Identification
    truth: dict[str, float]
    numpy_seconds: float
    workers: int

    @property
    def evaluations_per_second(self) -> float:
        """Return the fitness evaluations per second, all cores together, without the part of a resumed search that ran
        earlier.
        """
        return self.identification.trials.made / self.identification.search_seconds

    @property
    def ratio_to_numpy(self) -> float:
        """Return how many times faster one evaluation is, on one core, than the NumPy expression in the same process.

        Both times are processor times, so other work on the machine does not matter.
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
    """Record the paper's 2,500 samples into `folder` and search the parameters as the paper did.

    evaluations: the number of fitness evaluations of each trial. seed: the seed of the simulated stand and of the
    search. checkpoint: see `Search`; the same seed records the same samples again, so a search can be resumed. Raises
    WrongUse, DriverError.
    """
    path = _record(folder, seed)
    settings = replace(PRESETS["paper"], generations=evaluations)
    workers = min(workers, trials)
    search = Search("paper", settings, trials=trials, seed=seed, workers=workers, bounds={}, checkpoint=checkpoint)
    model = parse_model("linear")
    # compile before the timed search, with enough generations for the same engine to be chosen
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
        default_amplitude=_AMPLITUDE * stand.checked_limits().torque,
        duration=(SAMPLES - 1) / RATE,
        band=_BAND,
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
    """Return the processor time, s, of one fitness evaluation in plain NumPy: the shortest of many."""
    dtheta, rate, torque = signals.motion.dtheta, signals.motion.dtheta_dot, signals.torque
    stiffness, damping = (PAPER[name][0] for name in COUPLING)
    best, end = float("inf"), time.process_time() + _MEASURE
    while time.process_time() < end:
        began = time.process_time()
        for _ in range(100):
            np.mean(np.abs(torque - (dtheta * stiffness + rate * damping)))
        best = min(best, (time.process_time() - began) / 100)
    return best
