"""Pictures of the search: how fast it converged (the paper's Figure 8), and the fitness over Kc and Bc with the
populations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.report.chart import Chart, Heat, Line, Panel
from hil.report.formatting import people_unit
from hil.report.identification import milli
from hil.report.pictures.traces import linear_problem

if TYPE_CHECKING:
    from ga.trials.outcome import Trials
    from hil.identification.result import Estimate, Identification

Array = NDArray[np.float64]
Span = tuple[float, float]

PARAMETERS = ("Kc", "Bc")
_NO_GAP = 1e-16  # for a logarithm: a trial that found the exact optimum has none
_SAME = 1e-9  # relative difference of two values of one fitness
_GRID = 41  # values of Kc and of Bc in a landscape
_ROWS = 20_000  # whose residual changes its sign in a landscape: enough for its shape
_BESIDE = 3.0  # half-widths of the interval that the near landscape shows on each side
_WIDE = 0.6  # of the value, that the far landscape shows on each side at least
_UNKNOWN = 0.2  # of the value, for half an interval that is not finite


def is_of_one_fitness(found: Identification) -> bool:
    """Return whether the trials minimised the fitness of the exact optimum, so that their curves approach this optimum.

    A search over nonlinear parameters minimises another fitness.
    """
    reached = float(found.trials.history.fitness[:, -1].min())
    return bool(np.isclose(reached, found.trials.fitness.min(), rtol=_SAME, atol=0.0))


def convergence_chart(trials: Trials, optimum: float, factor: float, unit: str) -> Chart:
    """Return the best fitness of every trial over the generations, and its difference from the exact optimum.

    optimum: fitness of the exact optimum, N m. factor, unit: from SI to the printed unit of torque.
    """
    history = trials.history
    generation = history.generation.astype(np.float64)
    gaps = np.maximum(history.fitness / optimum - 1.0, _NO_GAP) if optimum > 0.0 else np.ones_like(history.fitness)
    fitness = factor * history.fitness
    best = Line("exact optimum", generation, np.full_like(generation, factor * optimum), "error", dashed=True)
    is_wide = float(fitness[:, 0].mean()) > 2.0 * factor * optimum > 0.0
    label = "optimiser gap, relative"
    return Chart(
        [
            Panel(
                "generation",
                f"best fitness [{unit}]",
                [*_trials(generation, fitness), best],
                x_scale="symlog",
                scale="log" if is_wide else "linear",
            ),
            Panel("generation", label, _trials(generation, gaps), x_scale="symlog", scale="log"),
        ],
        columns=2,
    )


def _trials(generation: Array, values: Array) -> list[Line]:
    """Return a thin line for each trial (t, g) over the generations (g,), and a thick one for their mean."""
    each = [Line("" if at else "one trial", generation, one, "soft", width=0.5) for at, one in enumerate(values)]
    return [*each, Line(f"mean of {len(values)}", generation, values.mean(axis=0), width=2.0)]


def convergence_text(found: Identification) -> str:
    """Return in words how fast the search converged."""
    factor, unit = people_unit("N*m", milli=milli(found))
    history, trials = found.trials.history, found.trials
    first = f"{factor * float(history.fitness[:, 0].mean()):.5g}"
    last = f"{factor * float(history.fitness[:, -1].mean()):.5g}"
    generations = f"{int(trials.generations.min())} to {int(trials.generations.max())}"
    return (
        f"Best fitness of {len(trials.fitness)} trials over the generations (the paper's Figure 8): on average "
        f"{first} {unit} in the first population and {last} {unit} after {generations} generations; the exact optimum "
        f"is {factor * found.optimum:.5g} {unit}, and the best trial is {found.optimiser_gap:.1e} above it."
    )


@dataclass(frozen=True, eq=False)
class Landscape:
    """The mean absolute error of the model over a grid of Kc and Bc, with the other parameters at their optimum.

    error: (b, k), N m. Kc: values of the columns (k,), N m/rad. Bc: values of the rows (b,), N m s/rad.
    """

    Kc: Array
    Bc: Array
    error: Array


def landscape(found: Identification, spans: tuple[Span, Span]) -> Landscape:
    """Return the landscape for the ranges `spans` of Kc and Bc, SI.

    Samples whose residual has the same sign in the whole landscape contribute a linear function of Kc and Bc. The other
    samples are summed one by one; if there are many, only a part of them.
    """
    columns, target = linear_problem(found)
    values = found.values[: columns.shape[1]]
    fitted = found.fitted
    residuals = (target - columns @ values)[fitted]
    places = [[estimate.name for estimate in found.estimates].index(name) for name in PARAMETERS]
    pair = columns[fitted][:, places]
    axes = [np.linspace(*span, _GRID) for span in spans]
    offsets = [axis - values[place] for axis, place in zip(axes, places, strict=True)]
    reach = np.abs(pair) @ [np.abs(one).max() for one in offsets]
    open_ = np.abs(residuals) < reach
    slope = np.sign(residuals[~open_]) @ pair[~open_]
    total = np.abs(residuals[~open_]).sum() - np.add.outer(slope[1] * offsets[1], slope[0] * offsets[0])
    every = -(-int(open_.sum()) // _ROWS) or 1
    some, left = pair[open_][::every], residuals[open_][::every]
    share = float(open_.sum()) / max(len(left), 1)
    for row, offset in enumerate(offsets[1]):
        errors = np.abs((left - offset * some[:, 1])[:, None] - some[:, :1] * offsets[0])
        total[row] += share * errors.sum(axis=0)
    return Landscape(axes[0], axes[1], total / len(residuals))


def has_landscape(found: Identification) -> bool:
    """Return whether Kc and Bc are linear parameters of the model, so that a landscape can be computed."""
    linear = [parameter.name for parameter in found.model.linear]
    return all(name in linear for name in PARAMETERS)


def landscape_chart(found: Identification) -> Chart:
    """Return two landscapes: one as wide as the first population, one around the interval of the result."""
    far, near = _spans(found)
    panels = [_landscape_panel(found, far, "from afar"), _landscape_panel(found, near, "about the result")]
    return Chart(panels, columns=2)


def landscape_text(found: Identification) -> str:
    """Return the landscape in words."""
    factor, unit = people_unit("N*m", milli=milli(found))
    far, _ = _spans(found)
    edge = landscape(found, far).error
    said = (
        f"Fitness over Kc and Bc, the other parameters at their optimum: {factor * found.optimum:.4g} {unit} at the "
        f"exact optimum (cross), {factor * float(edge.max()):.4g} {unit} at most in the left panel."
    )
    populations = _population(found)
    if populations is None:
        return said
    spread = [_spread(found, name, genes) for genes in populations for name in PARAMETERS]
    return (
        f"{said} The first generation lies between {spread[0]} and {spread[1]}, the last of the best trial between "
        f"{spread[2]} and {spread[3]}."
    )


def _spread(found: Identification, name: str, genes: Array) -> str:
    factor, unit = people_unit(found[name].unit, milli=milli(found))
    values = factor * genes[:, _place(found, name)]
    return f"{name} {values.min():.5g} to {values.max():.5g} {unit}"


def _place(found: Identification, name: str) -> int:
    return [estimate.name for estimate in found.estimates].index(name)


def _population(found: Identification) -> tuple[Array, Array] | None:
    """Return Kc and Bc in the first and in the last generation of the best trial; None if Kc and Bc were computed
    directly.
    """
    kept = found.trials.populations
    return None if kept is None else (kept.first, kept.last)


def _spans(found: Identification) -> tuple[tuple[Span, Span], tuple[Span, Span]]:
    """Return the ranges of Kc and Bc, SI, in the wide landscape and in the narrow landscape."""
    near = [_near(found[name]) for name in PARAMETERS]
    kept = found.trials.populations
    genes = np.empty((0, 0)) if kept is None else kept.first
    far = [
        _far(span, found[name].exact, genes[:, _place(found, name)] if genes.size else np.empty(0))
        for span, name in zip(near, PARAMETERS, strict=True)
    ]
    return (far[0], far[1]), (near[0], near[1])


def _near(estimate: Estimate) -> Span:
    low, high = estimate.ci95
    half = 0.5 * (high - low)
    if not np.isfinite(half) or half <= 0.0:
        half = _UNKNOWN * abs(estimate.exact) or 1.0
        low, high = estimate.exact - half, estimate.exact + half
    beside = (_BESIDE - 1.0) * half
    return min(low, estimate.exact) - beside, max(high, estimate.exact) + beside


def _far(near: Span, middle: float, genes: Array) -> Span:
    """Return a range around `middle` that contains all values in `genes` and the range `near`."""
    reach = 1.08 * float(np.abs(genes - middle).max(initial=0.0))
    half = max(reach, near[1] - middle, middle - near[0], _WIDE * abs(middle))
    return middle - half, middle + half


def _landscape_panel(found: Identification, spans: tuple[Span, Span], title: str) -> Panel:
    (stiffness, kc), (damping, bc) = (people_unit(found[name].unit, milli=milli(found)) for name in PARAMETERS)
    torque, unit = people_unit("N*m", milli=milli(found))
    (left, right), (low, high) = spans
    extent = (stiffness * left, stiffness * right, damping * low, damping * high)
    heat = Heat(torque * landscape(found, spans).error, extent, f"mean |torque error| [{unit}]")
    kc_exact, bc_exact = np.array([stiffness * found["Kc"].exact]), np.array([damping * found["Bc"].exact])
    lines = [
        *_interval(found, stiffness, damping),
        *_populations(found, stiffness, damping, extent),
        Line("exact optimum", kc_exact, bc_exact, "ink", mark="ring"),
    ]
    return Panel(f"Kc [{kc}]", f"Bc [{bc}]", lines, title=title, heat=heat)


def _populations(
    found: Identification, stiffness: float, damping: float, extent: tuple[float, float, float, float]
) -> list[Line]:
    """Return the individuals of the first and of the last generation within the landscape. stiffness, damping: factors
    from SI to the printed units. extent: ends of the axes.
    """
    lines: list[Line] = []
    left, right, low, high = extent
    styles = (("first generation", "soft"), ("last generation", "good"))
    for genes, (name, colour) in zip(_population(found) or (), styles, strict=False):
        kc, bc = (
            scale * genes[:, _place(found, one)] for scale, one in zip((stiffness, damping), PARAMETERS, strict=True)
        )
        seen = (kc >= left) & (kc <= right) & (bc >= low) & (bc <= high)
        lines.append(Line(name, kc[seen], bc[seen], colour, mark="dot"))
    return lines


def _interval(found: Identification, stiffness: float, damping: float) -> list[Line]:
    """Return the rectangle of the 95 % intervals of Kc and Bc; no line if one of the intervals is not known."""
    (low, high), (least, most) = (found[name].ci95 for name in PARAMETERS)
    if not np.isfinite([low, high, least, most]).all():
        return []
    kc, bc = stiffness * np.array([low, high, high, low, low]), damping * np.array([least, least, most, most, least])
    return [Line("95 % interval", kc, bc, "error", width=1.4)]
