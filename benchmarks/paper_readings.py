"""What each reading of the paper's text gives, into results/paper_readings.csv."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from page import machine, write_result

from ga.bounds import PAPER_BOUNDS
from ga.evolution.evolution import PRESETS
from ga.lad.exact import least_absolute_deviations
from ga.trials.trials import run_trials

HEAD = (
    "| selection | weights | replacement | mutation | Kc, mN m/rad | Bc, mN m s/rad | gap |\n"
    "| --- | --- | --- | --- | --- | --- | --- |"
)


def main() -> None:
    time = np.arange(2500) / 500
    dtheta = 0.3 * np.sin(2 * np.pi * (0.2 + 0.5 * time) * time)
    columns = np.stack([dtheta, np.gradient(dtheta, time)], axis=1)
    torque = columns @ [17.75e-3, 0.19e-3] + np.random.default_rng(0).normal(scale=2e-4, size=time.size)
    exact = least_absolute_deviations(columns, torque)
    replacements = ("worst", "worst-if-better", "oldest", "random")
    readings = [(*r, 0.6) for r in product(("minimise", "larger"), ("error", "inverse-error"), replacements)]
    lines = [HEAD]
    for selection, weights, replacement, mutation in [*readings, ("minimise", "error", "worst", 0.1)]:
        settings = replace(
            PRESETS["paper"],
            selection=selection,
            weights=weights,
            replacement=replacement,
            mutation=mutation,
            generations=200_000,
        )
        trials = run_trials(columns, torque, PAPER_BOUNDS, settings, trials=30, seed=0, workers=2)
        (kc, bc), (kc_std, bc_std) = trials.mean * 1e3, trials.std * 1e3
        gap = exact.relative_gap(float(trials.fitness.mean()))
        lines.append(
            f"| {selection} | {weights} | {replacement} | {mutation:g} | {kc:.4f} ± {kc_std:.4f} "
            f"| {bc:.5f} ± {bc_std:.5f} | {gap:.1e} |"
        )
        print(lines[-1], flush=True)
    about = (
        "30 trials of 200,000 generations, seed 0; gap: of the mean fitness of the trials, relative to the exact one"
    )
    write_result("paper_readings", f"{machine()}; {about}.\n\n" + "\n".join(lines))


if __name__ == "__main__":
    main()
