"""What a yielding fixture does to Kc and Bc of the paper's joint, and what is left of it after the correction.

    python benchmarks/fixture.py

A chirp of 0.1 to 15 Hz on joint and fixture in series, integrated in time. Writes results/fixture.csv.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from page import machine, write_result
from scipy.integrate import solve_ivp

from ga.lad.exact import least_absolute_deviations
from hil.identification.series_compliance import Element, Excitation, corrected

Array = NDArray[np.float64]
JOINT = np.array([17.75e-3, 0.19e-3])
LOW, HIGH, LENGTH, AMPLITUDE = 0.1, 15.0, 20.0, 0.35
NOISE, SEEDS = 2e-4, 10


def angle(t: Array) -> Array:
    return AMPLITUDE * np.sin(2.0 * np.pi * (LOW * t + (HIGH - LOW) * t * t / (2.0 * LENGTH)))


def rate(t: Array) -> Array:
    phase = 2.0 * np.pi * (LOW * t + (HIGH - LOW) * t * t / (2.0 * LENGTH))
    return AMPLITUDE * np.cos(phase) * 2.0 * np.pi * (LOW + (HIGH - LOW) * t / LENGTH)


def swept(fixture: Element) -> tuple[Array, Array, Array]:
    """Time, columns and torque of the two in series."""
    time = np.arange(0.0, LENGTH, 0.002)

    def stretching(t: Array, coupling: Array) -> Array:
        force = fixture.stiffness * (angle(t) - coupling) + fixture.damping * rate(t) - JOINT[0] * coupling
        return np.asarray(force / (JOINT[1] + fixture.damping))

    run = solve_ivp(stretching, (0.0, LENGTH), [0.0], "LSODA", t_eval=time, rtol=1e-8, atol=1e-11, max_step=0.01)
    torque = JOINT[0] * run.y[0] + JOINT[1] * stretching(time, run.y[0])
    return time, np.column_stack([angle(time), rate(time)]), torque


def by_closed_forms(fit: Array, fixture: Element) -> Array:
    stiffness = 1.0 / (1.0 / fit[0] - 1.0 / fixture.stiffness)
    return np.array([stiffness, stiffness**2 * (fit[1] / fit[0] ** 2 - fixture.damping / fixture.stiffness**2)])


def row(ratio: float, lag: float) -> str:
    fixture = Element(ratio * JOINT[0], ratio * JOINT[0] * lag)
    time, columns, torque = swept(fixture)
    rng = np.random.default_rng(1)
    noisy = [torque + NOISE * rng.standard_normal(len(torque)) for _ in range(SEEDS)]
    least_squares = np.linalg.lstsq(columns, torque, rcond=None)[0]
    without = least_absolute_deviations(columns, torque).genes
    with_noise = np.mean([least_absolute_deviations(columns, one).genes for one in noisy], axis=0)
    moved = Excitation.of(time, columns[:, 0])
    cells = [least_squares, by_closed_forms(least_squares, fixture)]
    for fit in (least_squares, with_noise, without):
        found = corrected(Element(*fit), fixture, moved)
        cells.append(np.array([found.stiffness, found.damping]))
    said = " | ".join("{:.2f}, {:.2f}".format(*(100.0 * (cell / JOINT - 1.0))) for cell in cells)
    return f"| {ratio:g} | {1e3 * lag:g} ms | {said} |"


def main() -> None:
    headings = "as measured | by the closed forms | by `hil` | least absolute, 0.2 mN m of noise | the same, no noise"
    lines = [f"| fixture over joint | B/K of the fixture | {headings} |", "| --- " * 7 + "|"]
    for ratio, lag in ((20.0, 1e-4), (10.0, 1e-3), (5.0, 2e-3), (3.0, 5e-3)):
        lines.append(row(ratio, lag))
        print(lines[-1], flush=True)
    about = (
        f"Errors of Kc and Bc, per cent, of the paper's joint in a compliant fixture, seed 1; {machine()}.\n"
        f"The first three columns of errors: least squares without noise; 0.2 mN m of noise: mean of {SEEDS} draws."
    )
    write_result("fixture", "\n".join([about, "", *lines]))


if __name__ == "__main__":
    main()
