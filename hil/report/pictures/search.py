"""Figures of the search: how fast it converged (the paper's Figure 8), and the fitness over Kc and Bc with the
populations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.report.formatting import people_unit
from hil.report.identification import milli
from hil.report.pictures.canvas import canvas, plain_ticks
from hil.report.pictures.traces import linear_problem

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ga.trials.outcome import Trials
    from hil.identification.result import Estimate, Identification

Array = NDArray[np.float64]
Span = tuple[float, float]

PARAMETERS = ("Kc", "Bc")
_NO_GAP = 1e-16  # for a logarithm: a trial that found the exact optimum has none
_GRID = 41  # values of Kc and of Bc in a landscape
_ROWS = 20_000  # whose residual changes its sign in a landscape: enough for its shape
_BESIDE = 3.0  # half-widths of the interval that the near landscape shows on each side
_WIDE = 0.6  # of the value, that the far landscape shows on each side at least
_UNKNOWN = 0.2  # of the value, for half an interval that is not finite


def convergence_drawn(found: Identification) -> Figure:
    """Return a figure of the best fitness of every trial over the generations, and of its difference from the exact
    optimum.
    """
    drawn, panels = canvas(1, 2, (9, 3.8))
    factor, unit = people_unit("N*m", milli=milli(found))
    draw_convergence(found.trials, found.optimum, panels, factor, unit)
    return drawn


def draw_convergence(trials: Trials, optimum: float, panels: list[Axes], factor: float, unit: str) -> None:
    """Draw the best fitness of every trial, and its difference from the exact optimum.

    optimum: fitness of the exact optimum, N m. factor, unit: from SI to the printed unit of torque.
    """
    history = trials.history
    mean = history.fitness.mean(axis=0)
    gaps = np.maximum(history.fitness / optimum - 1.0, _NO_GAP) if optimum > 0.0 else np.full_like(history.fitness, 1.0)
    for panel, each, average in ((panels[0], factor * history.fitness, factor * mean), (panels[1], gaps, gaps.mean(0))):
        panel.plot(history.generation, each.T, lw=0.5, color="C0", alpha=0.35)
        panel.plot([], [], lw=0.5, color="C0", label="one trial")
        panel.plot(history.generation, average, lw=2.2, color="C0", label=f"mean of {len(each)}")
        panel.set_xscale("symlog", linthresh=1.0)
        panel.set(xlabel="generation", xlim=(0, max(1, int(history.generation[-1]))))
    panels[0].axhline(factor * optimum, color="C3", ls="--", lw=1.2, label="exact optimum")
    if mean[0] > 2.0 * optimum > 0.0:
        panels[0].set_yscale("log")
    panels[0].ticklabel_format(axis="y", useOffset=False) if panels[0].get_yscale() == "linear" else None
    panels[0].set(ylabel=f"best fitness [{unit}]")
    panels[0].legend(loc="upper right")
    panels[1].set(yscale="log", ylabel="optimiser gap, relative")
    plain_ticks(*panels)


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


def landscape_drawn(found: Identification) -> Figure:
    """Return a figure of two landscapes: one as wide as the first population, one around the interval of the result."""
    drawn, panels = canvas(1, 2, (9, 4.2))
    far, near = _spans(found)
    _draw_landscape(found, far, panels[0])
    _draw_landscape(found, near, panels[1])
    panels[0].set(title="from afar")
    panels[1].set(title="about the result")
    handles, labels = panels[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return drawn


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


def _draw_landscape(found: Identification, spans: tuple[Span, Span], panel: Axes) -> None:
    (stiffness, kc), (damping, bc) = (people_unit(found[name].unit, milli=milli(found)) for name in PARAMETERS)
    torque, unit = people_unit("N*m", milli=milli(found))
    seen = landscape(found, spans)
    (left, right), (low, high) = spans
    extent = (stiffness * left, stiffness * right, damping * low, damping * high)
    panel.grid(visible=False)
    shades = panel.imshow(
        torque * seen.error, origin="lower", extent=extent, aspect="auto", cmap="Blues_r", interpolation="bilinear"
    )
    panel.figure.colorbar(shades, ax=panel, label=f"mean |torque error| [{unit}]", format="%.4g")
    panel.contour(stiffness * seen.Kc, damping * seen.Bc, torque * seen.error, 10, colors="0.35", linewidths=0.4)
    _draw_interval(found, panel, stiffness, damping)
    place = stiffness * found["Kc"].exact, damping * found["Bc"].exact
    panel.plot(*place, "+", ms=22, mew=2.2, color="C1", label="exact optimum")
    _draw_population(found, panel, stiffness, damping)
    panel.set(xlim=extent[:2], ylim=extent[2:], xlabel=f"Kc [{kc}]", ylabel=f"Bc [{bc}]")


def _draw_population(found: Identification, panel: Axes, stiffness: float, damping: float) -> None:
    populations = _population(found)
    if populations is None:
        return
    columns = [_place(found, name) for name in PARAMETERS]
    styles = (("first generation", "o", "w"), ("last generation", "D", "C2"))
    for genes, (label, marker, colour) in zip(populations, styles, strict=True):
        kc, bc = (genes[:, column] for column in columns)
        panel.plot(stiffness * kc, damping * bc, marker, ms=4.5, mfc=colour, mec="k", mew=0.6, ls="none", label=label)


def _draw_interval(found: Identification, panel: Axes, stiffness: float, damping: float) -> None:
    from matplotlib.patches import Rectangle

    (low, high), (least, most) = (found[name].ci95 for name in PARAMETERS)
    if np.isfinite([low, high, least, most]).all():
        corner, size = (stiffness * low, damping * least), (stiffness * (high - low), damping * (most - least))
        panel.add_patch(Rectangle(corner, *size, fill=False, ec="C3", lw=1.4, label="95 % interval"))
