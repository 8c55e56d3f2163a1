"""How often the 95 % interval of several recordings' common value holds it, by estimator, for few recordings.

    python benchmarks/repeatability.py [--seeds 2000]

Values are drawn with known standard errors, uniform on 0.5 to 1.5, and a between-recording standard deviation of 0,
0.5, 1 and 3. Writes results/repeatability.csv.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from page import machine, write_result
from scipy.special import stdtrit

from hil.identification.verdict.random_effects import between

Array = NDArray[np.float64]
Interval = tuple[float, float]
METHODS = ("one value for all", "DerSimonian-Laird, normal", "Paule-Mandel, Student", "Hartung-Knapp", "hil")


def weighted(values: Array, variances: Array) -> tuple[float, float, float]:
    """Mean, its standard error, and Hartung and Knapp's."""
    weight = 1.0 / variances
    mean = float(weight @ values / weight.sum())
    error = float(weight.sum() ** -0.5)
    return mean, error, error * float(np.sqrt(weight @ (values - mean) ** 2 / (len(values) - 1)))


def intervals(values: Array, errors: Array) -> tuple[list[Interval], Interval]:
    """Centre and half-width by each method, and the interval of the between-recording standard deviation."""
    pooled, student = between(values, errors), float(stdtrit(len(values) - 1, 0.975))
    weight, common = 1.0 / errors**2, weighted(values, errors**2)
    scatter = float(weight @ (values - common[0]) ** 2) - (len(values) - 1)
    laird = max(0.0, scatter / float(weight.sum() - (weight**2).sum() / weight.sum()))
    normal, mandel = weighted(values, errors**2 + laird), weighted(values, errors**2 + pooled.between**2)
    return [
        (common[0], 1.959964 * common[1]),
        (normal[0], 1.959964 * normal[1]),
        (mandel[0], student * mandel[1]),
        (mandel[0], student * mandel[2]),
        (pooled.value, 0.5 * (pooled.ci95[1] - pooled.ci95[0])),
    ], pooled.between_ci95


def row(count: int, ratio: float, seeds: int) -> str:
    rng = np.random.default_rng([count, round(10 * ratio)])
    held, width, covered = np.zeros(len(METHODS)), np.zeros(len(METHODS)), 0
    for _ in range(seeds):
        errors = rng.uniform(0.5, 1.5, count)
        values = ratio * rng.standard_normal(count) + errors * rng.standard_normal(count)
        found, span = intervals(values, errors)
        held += [abs(centre) <= half for centre, half in found]
        width += [2.0 * half for _, half in found]
        covered += span[0] <= ratio <= span[1]
    cells = " | ".join(f"{100 * hit / seeds:.1f} ({wide / seeds:.2g})" for hit, wide in zip(held, width, strict=True))
    return f"| {count} | {ratio:g} | {cells} | {100 * covered / seeds:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2000)
    seeds = parser.parse_args().seeds
    lines = [f"| recordings | between / within | {' | '.join(METHODS)} | between itself |", "| --- " * 8 + "|"]
    for count in (2, 3, 5, 10):
        for ratio in (0.0, 0.5, 1.0, 3.0):
            lines.append(row(count, ratio, seeds))
            print(lines[-1], flush=True)
    about = (
        f"{seeds} draws a row, numpy's default_rng([recordings, 10 ratio]); {machine()}.\n"
        "95 % intervals that cover the common value, per cent, and in brackets their mean width.\n"
        '"between itself": coverage of the interval of the between-recording standard deviation.'
    )
    write_result("repeatability", "\n".join([about, "", *lines]))


if __name__ == "__main__":
    main()
