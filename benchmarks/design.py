"""The errors that `hil design` predicts against those found: many recordings of each profile on the simulated stand.

python benchmarks/design.py               200 seeds of every case, into results/design.csv
python benchmarks/design.py --seeds 1000
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from page import machine, write_result

from drivers.servo import Quantity
from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse as parse_model
from hil.acquisition import excitation
from hil.acquisition.excitation import Profile
from hil.acquisition.run import run
from hil.experiment_design.advice import described
from hil.experiment_design.assessment import Assessment, assess, task_of
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.stand.file import SIMULATED, Stand, parse

RATE = 500.0


@dataclass(frozen=True)
class Case:
    name: str
    kind: str
    band: tuple[float, float]
    amplitude: float
    duration: float
    model: str = "linear"
    quantity: Quantity = Quantity.TORQUE
    stand: str = SIMULATED


COARSE = SIMULATED + "\n[sim.sensors]\ntorque_cell_lsb = 1e-3\ntorque_cell_noise = 3e-4\nmotor_counts = 1024\n"
MOTOR_SIDE = SIMULATED.replace('"joint"', '"motor"')

CASES = (
    Case("the usual one", "chirp", (0.1, 15.0), 0.006, 4.0),
    Case("around the resonance", "multisine", (4.21, 18.2), 0.0108, 4.0),
    Case("with its nuisances", "prbs", (0.25, 30.0), 0.005, 4.0, "linear+offset+coulomb"),
    Case("coarse counts: 1 mN m, 1024 a turn", "multisine", (1.0, 10.0), 0.006, 4.0, stand=COARSE),
    Case("deflection prescribed", "chirp", (0.1, 15.0), 0.35, 4.0, quantity=Quantity.POSITION),
    Case("torque from the motor's side", "chirp", (0.1, 15.0), 0.006, 4.0, stand=MOTOR_SIDE),
)  # fmt: skip


def profile_of(case: Case) -> Profile:
    return excitation.make(
        case.kind,
        case.quantity,
        amplitude=case.amplitude,
        default_amplitude=case.amplitude,
        duration=case.duration,
        band=case.band,
        rate=RATE,
        seed=1,
    )


def predicted(case: Case, stand: Stand) -> Assessment:
    task = task_of(stand, kc=None, bc=None, torque_noise=None, model=case.model, mode=case.quantity, rate=RATE)
    return assess(task, profile_of(case))


def found(case: Case, stand: Stand, seed: int, folder: Path) -> NDArray[np.float64]:
    """Kc and Bc of one recording: the exact optimum of `hil identify`."""
    path, outcome = run(stand, profile_of(case), rate=RATE, seed=seed, output=folder / "run.h5", force=True)
    assert outcome.error is None, outcome.error
    search = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
    estimates = identify([path], parse_model(case.model), search)
    return np.array([estimates[name].value for name in ("Kc", "Bc")])


def rows(case: Case, seeds: int) -> list[str]:
    stand = parse(case.stand)
    judged = predicted(case, stand)
    with tempfile.TemporaryDirectory() as folder:
        genes = np.array([found(case, stand, seed, Path(folder)) for seed in range(seeds)])
    lines = []
    for index, name in enumerate(("Kc", "Bc")):
        parameter = judged[name]
        spread = float(genes[:, index].std(ddof=1))
        wrong = float(genes[:, index].mean()) / parameter.rough - 1.0
        lines.append(
            f"| {f'{described(judged.profile)}: {case.name}' if not index else ''} | {case.model if not index else ''} "
            f"| {name} | {parameter.error / parameter.rough:.3%} | {spread / parameter.rough:.3%} "
            f"| {spread / parameter.error:.2f} | {parameter.bound / parameter.rough:.3%} "
            f"| {parameter.bias / parameter.rough:+.2%} | {wrong:+.2%} |"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    options = parser.parse_args()
    table = []
    for case in CASES:
        begin = time.perf_counter()
        table += rows(case, options.seeds)
        print(f"{case.name}: {time.perf_counter() - begin:.0f} s", *table[-2:], sep="\n", flush=True)
    text = "\n".join(
        [
            f"{options.seeds} seeds a case; a found error is uncertain by {1 / np.sqrt(2 * options.seeds):.0%}. "
            f"{machine()}.\n",
            "| profile | model | | predicted s.e. | found | ratio | Cramér-Rao | predicted bias | found |",
            "| --- | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
            *table,
        ]
    )
    write_result("design", text)


if __name__ == "__main__":
    main()
