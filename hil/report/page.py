"""The page of a result: HTML that stands alone, and its picture beside it."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.recording.output import atomic_write
from hil.report.formatting import people_unit
from hil.report.identification import headline, identification_lines, milli, printed
from hil.report.lack_of_fit import draw_correlation, draw_dynamic_stiffness, draw_plane

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.diagnostics import Diagnostic
    from hil.identification.result import Identification

Array = NDArray[np.float64]

_STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto}td,th{padding:.2rem 1rem .2rem 0;text-align:left}"
    "img{max-width:100%}"
)


def page_files(path: Path) -> tuple[Path, Path]:
    """Return the page at `path` and the picture beside it. Raises WrongUse where the two would be one file."""
    picture = path.with_suffix(".png")
    if picture == path:
        page = path.with_suffix(".html")
        raise WrongUse(f"{path} is the name of the report's picture: name the page, such as {page}")
    return path, picture


def write_page(found: Identification, path: Path, *, force: bool) -> list[Path]:
    """Write the page to `path` and its picture beside it; return both. force: replace files there. Raises WrongUse."""
    path, picture = page_files(path)
    save_picture(figure(found), picture, force=force)
    heading = ", ".join(str(recording) for recording in found.recordings)
    lines = identification_lines(found)
    write_html(
        path,
        picture,
        alt="measured and modelled torque",
        heading=heading,
        rows=_rows(found),
        lines=lines,
        diagnostics=found.diagnostics,
        force=force,
    )
    return [path, picture]


def write_html(
    path: Path,
    picture: Path,
    *,
    alt: str,
    heading: str,
    rows: Iterable[Sequence[str]],
    lines: Iterable[str],
    diagnostics: Iterable[Diagnostic],
    force: bool,
) -> None:
    """Write a page that holds its picture: heading, a table whose first row is its headings, lines, warnings."""
    table = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    text = "".join(f"<p>{html.escape(line)}</p>" for line in lines)
    messages = "".join(f"<li>{one.severity}: {html.escape(one.message)}</li>" for one in diagnostics)
    data = base64.b64encode(picture.read_bytes()).decode()
    page = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>hil</title>'
        f"<style>{_STYLE}</style><h1>{html.escape(heading)}</h1><table>{table}</table>{text}<ul>{messages}</ul>"
        f'<img alt="{alt}" src="data:image/png;base64,{data}"></html>\n'
    )
    with atomic_write(path, force=force) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _rows(found: Identification) -> Iterator[Sequence[str]]:
    yield "", "value", "95 % interval", "unit", "identifiable"
    for estimate in found.estimates:
        value, _, interval, unit = printed(found, estimate)
        yield estimate.name, value, interval, unit, "yes" if estimate.identifiable else "no"


def figure(found: Identification) -> Figure:
    """Return the picture: torque and model over time, residuals, the loop, the test of the model, dynamic stiffness.

    A line ends where a recording ends, or a gap begins.
    """
    from matplotlib.figure import Figure

    motion, torque, model = found.signals.motion, found.signals.torque, _modelled(found)
    factor, unit = people_unit("N*m", milli=milli(found))
    time, measured, modelled, residuals, dtheta = (
        _broken(values, motion.starts)
        for values in (motion.time, torque * factor, model * factor, (torque - model) * factor, motion.dtheta)
    )
    drawn = Figure(figsize=(10, 9), layout="constrained")
    panels = drawn.subplot_mosaic(
        [
            ["torque", "torque", "loop"],
            ["residuals", "residuals", "loop"],
            ["correlation", "plane", "dynamic"],
        ],
        height_ratios=[2, 1, 1.5],
    )
    panels["torque"].plot(time, measured, lw=0.8, color="0.65", label="measured")
    panels["torque"].plot(time, modelled, lw=0.6, color="C0", label=found.model.name)
    panels["torque"].set(ylabel=f"torque at the joint [{unit}]", title=headline(found))
    panels["torque"].legend(loc="upper right")
    panels["residuals"].plot(time, residuals, lw=0.4, color="C3")
    panels["residuals"].set(xlabel="time [s]", ylabel=f"error [{unit}]")
    panels["loop"].plot(dtheta, measured, ".", ms=1, color="0.65")
    panels["loop"].plot(dtheta, modelled, lw=0.3, color="C0")
    panels["loop"].set(xlabel="deflection [rad]", ylabel=f"torque at the joint [{unit}]")
    draw_correlation(found.lack_of_fit, panels["correlation"])
    draw_plane(found.lack_of_fit, panels["plane"], factor, unit)
    draw_dynamic_stiffness(found.dynamic_stiffness, panels["dynamic"], factor, f"{unit}/rad")
    for name in ("torque", "residuals", "loop", "correlation", "dynamic"):
        panels[name].grid(visible=True, lw=0.3)
    return drawn


def save_picture(figure: Figure, path: Path, *, force: bool) -> None:
    """Write a figure as a PNG. force: in place of one that is there. Raises WrongUse where it cannot be written."""
    with atomic_write(path, force=force) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def _broken(values: Array, starts: tuple[int, ...]) -> Array:
    """The values with a NaN before each stretch but the first, where a line is interrupted."""
    return np.insert(values, starts[1:], np.nan)


def _modelled(found: Identification) -> Array:
    """The torque of the model, (n,) N m, for the motion of the recordings."""
    signals = found.signals
    values = np.array([estimate.exact for estimate in found.estimates])
    nonlinear = values[len(found.model.linear) :]
    columns = found.model.columns(signals.motion, nonlinear)
    known = signals.torque - found.model.target(signals.motion, signals.torque, nonlinear)
    return np.asarray(known + columns @ values[: len(found.model.linear)])
