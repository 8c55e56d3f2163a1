"""What one evaluation costs in the paper's algorithm, for recordings of 10^3 to 10^7 samples and 2 to 5 parameters.

    python benchmarks/scaling.py [--longest 10000000]

One search, one core. Its first million generations grow the cell tree; the next million are timed. Beside it stands the
dense engine, which looks at every sample.
"""

from __future__ import annotations

import argparse
import resource
import time
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from page import DOCS, machine, write_result

from ga.bounds import bounds_from_data
from ga.evolution.evolution import PRESETS, advance, begin
from ga.fitness.cells import grow
from ga.fitness.dense import pack
from ga.fitness.engine import evaluate
from ga.lad.exact import least_absolute_deviations

GROWING, TIMED = 1_000_000, 1_000_000
ENOUGH = 420.0  # s after which nothing more is begun
TRUTH = np.array([17.75e-3, 0.19e-3, 1e-3, 5e-4, 0.05])


class Cost(NamedTuple):
    """growing: s, the first million generations, the data's preparation included. cells, dense: s an evaluation."""

    samples: int
    parameters: int
    growing: float
    cells: float
    dense: float
    exact: float


def recording(samples: int, p: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Five seconds of a chirp, however finely sampled, through linear+offset+coulomb+cubic, with 0.2 mN m of noise."""
    times = np.arange(samples) * (5.0 / samples)
    dtheta = 0.3 * np.sin(2 * np.pi * (0.2 + 0.5 * times) * times) + 0.1 * np.sin(2 * np.pi * 0.31 * times)
    rate = np.gradient(dtheta, times)
    columns = np.stack([dtheta, rate, np.ones(samples), np.tanh(rate / 0.05), dtheta**3][:p], axis=1)
    return columns, columns @ TRUTH[:p] + np.random.default_rng(0).normal(scale=2e-4, size=samples)


def measured(samples: int, p: int) -> Cost:
    columns, torque = recording(samples, p)
    began = time.process_time()
    exact = least_absolute_deviations(columns, torque)
    solving = time.process_time() - began
    bounds = bounds_from_data(columns, torque)
    dense = _dense_seconds(columns, torque, exact.genes)
    began = time.process_time()
    engine = grow(columns, torque, bounds)
    population = begin(engine, bounds, PRESETS["paper"], seed=0, trial=0)
    advance(engine, bounds, PRESETS["paper"], population, GROWING)
    growing = time.process_time() - began
    began = time.process_time()
    advance(engine, bounds, PRESETS["paper"], population, GROWING + TIMED)
    return Cost(samples, p, growing, (time.process_time() - began) / TIMED, dense, solving)


def _dense_seconds(columns: NDArray[np.float64], torque: NDArray[np.float64], genes: NDArray[np.float64]) -> float:
    """The best of five runs of some 20 ms, less the call from Python, which one sample tells."""
    best = []
    for engine in (pack(columns, torque), pack(columns[:1], torque[:1])):
        repeats = max(1, 20_000_000 // len(torque))
        runs = []
        for _ in range(5):
            began = time.process_time()
            for _ in range(min(repeats, 2000)):
                evaluate(engine, genes)
            runs.append((time.process_time() - began) / min(repeats, 2000))
        best.append(min(runs))
    return best[0] - best[1]


def _table(costs: list[Cost]) -> str:
    lines = [
        "| samples | parameters | cell tree, ns | dense, ns | growing the cell tree, s | exact optimum, s |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {c.samples:,} | {c.parameters} | {c.cells * 1e9:.0f} | {c.dense * 1e9:,.0f} | {c.growing:.2f} | "
        f"{c.exact:.2g} |"
        for c in costs
    ]
    return "\n".join(lines)


def _draw(costs: list[Cost]) -> None:
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    for p in sorted({c.parameters for c in costs}):
        of_p = [c for c in costs if c.parameters == p]
        samples = [c.samples for c in of_p]
        (line,) = axes.loglog(samples, [c.cells * 1e9 for c in of_p], "o-", label=f"cell tree, {p} parameters")
        axes.loglog(samples, [c.dense * 1e9 for c in of_p], "--", color=line.get_color(), label=f"dense, {p}")
    axes.set_xlabel("samples")
    axes.set_ylabel("one evaluation, ns of one core")
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize="small", ncols=2)
    (DOCS / "pictures").mkdir(parents=True, exist_ok=True)
    figure.savefig(DOCS / "pictures" / "scaling.png", dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--longest", type=int, default=10**7)
    longest = parser.parse_args().longest
    lengths = [n for n in (10**3, 2500, 10**4, 10**5, 10**6, 10**7) if n <= longest]
    for p in (2, 3):  # compiles what is timed
        measured(1000, p)
    began = time.perf_counter()
    costs, left_out = [], []
    for n, p in [(n, p) for n in lengths for p in (2, 3, 4, 5)]:
        if time.perf_counter() - began > ENOUGH:
            left_out.append(f"{n:,} samples with {p} parameters")
            continue
        costs.append(measured(n, p))
        print(_table(costs[-1:]).splitlines()[-1], flush=True)
    costs.sort(key=lambda c: (c.parameters, c.samples))
    _draw(costs)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    at = {(c.samples, c.parameters): c for c in costs}
    ratios = [
        f"{at[longest_n, p].cells / at[2500, p].cells:.2f} for {p}"
        for p in (2, 3, 4, 5)
        for longest_n in (10**6,)
        if (longest_n, p) in at
    ]
    write_result(
        "scaling",
        "## The cost of an evaluation against the length of the recording\n\n"
        "`python benchmarks/scaling.py` writes this file. One search of the `paper` preset on one core: its first "
        "million generations grow the cell tree, the next million are timed. Beside it stands the dense engine, which "
        "looks at every sample. The data are five seconds of a chirp, however finely sampled, with 0.2 mN m of noise."
        f"\n\nMeasured on {machine()}; {time.perf_counter() - began:.0f} s in all, at most {peak:.0f} MiB resident.\n\n"
        f"{_table(costs)}\n\n"
        f"An evaluation at 1,000,000 samples over one at 2,500, by the number of parameters: {', '.join(ratios)} (bar: "
        f"5).{' Left out for time: ' + ', '.join(left_out) + '.' if left_out else ''}",
    )


if __name__ == "__main__":
    main()
