"""The paper's experiment: how fast, and how much faster than the NumPy expression in the same process.

python benchmarks/replicate.py            30 trials of 2,000,000 evaluations, and what 200,000,000 would take
python benchmarks/replicate.py --full     30 trials of 200,000,000 evaluations
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from page import machine, write_result

from ga.bounds import PAPER_BOUNDS
from ga.evolution.evolution import PRESETS
from ga.lad.exact import least_absolute_deviations
from ga.trials.trials import run_trials
from hil.cli.progress import Lines

PAPER = 200_000_000


def recording() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """2,500 samples of the paper's joint under a chirp, with 0.2 mN m of noise, as in docs/paper.md."""
    times = np.arange(2500) / 500
    dtheta = 0.3 * np.sin(2 * np.pi * (0.2 + 0.5 * times) * times)
    columns = np.stack([dtheta, np.gradient(dtheta, times)], axis=1)
    noise = np.random.default_rng(0).normal(scale=2e-4, size=times.size)
    return columns, columns @ [17.75e-3, 0.19e-3] + noise


def numpy_seconds(columns: NDArray[np.float64], torque: NDArray[np.float64], repeats: int = 2000) -> float:
    """Seconds of one evaluation with NumPy, the best of nine runs."""
    dtheta, rate = (np.ascontiguousarray(column) for column in columns.T)
    kc, bc = 17.75e-3, 0.19e-3
    best = np.inf
    for _ in range(9):
        begin = time.perf_counter()
        for _ in range(repeats):
            np.mean(np.abs(torque - dtheta * kc - rate * bc))
        best = min(best, (time.perf_counter() - begin) / repeats)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="run all 6,000,000,000 evaluations")
    parser.add_argument("--trials", type=int, default=30)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    columns, torque = recording()
    settings = replace(PRESETS["paper"], generations=PAPER if options.full else 2_000_000)
    warm = replace(settings, generations=1_000_000)  # compile, if that was not done before
    run_trials(columns, torque, PAPER_BOUNDS, warm, trials=options.workers, seed=1, workers=options.workers)
    plain = numpy_seconds(columns, torque)
    begin, begin_cpu = time.perf_counter(), time.process_time()
    trials = run_trials(
        columns,
        torque,
        PAPER_BOUNDS,
        settings,
        trials=options.trials,
        seed=0,
        workers=options.workers,
        progress=partial(Lines(), "searching"),
    )
    seconds, cpu = time.perf_counter() - begin, time.process_time() - begin_cpu
    plain = min(plain, numpy_seconds(columns, torque))
    exact = least_absolute_deviations(columns, torque)
    kc, bc = zip(trials.mean * 1e3, trials.std * 1e3, strict=True)
    rows = [
        ("evaluations", f"{trials.evaluations:,}"),
        ("wall time, s", f"{seconds:.1f}"),
        ("processor time, s", f"{cpu:.1f}"),
        ("evaluations per second", f"{trials.evaluations / seconds:,.0f}"),
        ("one evaluation, ns of one core", f"{cpu / trials.evaluations * 1e9:.1f}"),
        ("the NumPy expression, ns of one core", f"{plain * 1e9:.0f}"),
        ("ratio, core for core", f"{plain * trials.evaluations / cpu:.0f}"),
        (f"ratio, {options.workers} workers against one NumPy", f"{plain * trials.evaluations / seconds:.0f}"),
        ("largest resident memory, MiB", f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f}"),
        ("Kc, mN m/rad", f"{kc[0]:.6f} ± {kc[1]:.6f} (exact {exact.genes[0] * 1e3:.6f})"),
        ("Bc, mN m s/rad", f"{bc[0]:.6f} ± {bc[1]:.6f} (exact {exact.genes[1] * 1e3:.6f})"),
        (
            "gap of the best and of the worst trial",
            ", ".join(f"{exact.relative_gap(float(f)):.1e}" for f in (trials.fitness.min(), trials.fitness.max())),
        ),
    ]
    if not options.full:
        scale = PAPER / settings.generations * 30 / options.trials
        rows.append(("extrapolated to 30 trials of 200,000,000, s", f"{seconds * scale:.0f}"))
    lines = [f"| {options.trials} trials of {settings.generations:,} | |", "| --- | --- |"]
    lines += [f"| {name} | {value} |" for name, value in rows]
    text = "\n".join(lines)
    print(text)
    print(machine())
    title = "The paper's experiment, in full" if options.full else "The paper's experiment, a hundredth of it"
    command = f"python benchmarks/replicate.py{' --full' * options.full}"
    write_result(
        "replicate-full" if options.full else "replicate",
        f"## {title}\n\n`{command}` writes this file. Measured on {machine()}.\n\n{text}",
    )


if __name__ == "__main__":
    main()
