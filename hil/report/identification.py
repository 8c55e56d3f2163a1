"""Results as people and machines read them: tables, JSON, a picture, a page. Nothing here prints."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.recording.output import atomic_write

if TYPE_CHECKING:  # rich costs 50 ms, and what these modules import more
    from rich.table import Table

    from hil.identification.result import Estimate, Fixture, Identification
    from hil.identification.stepwise import Rung
    from hil.signals.inspection import Inspection

SCHEMA = "hil-identification/1"


def people_unit(unit: str, *, milli: bool) -> tuple[float, str]:
    """The factor and the words in which people read a parameter: mN m for N m where `milli`, as in the paper."""
    if milli and unit.startswith("N*m"):
        return 1e3, ("mN m" + unit.removeprefix("N*m")).replace("*", " ")
    return 1.0, unit.replace("*", " ")


def _milli(found: Identification) -> bool:
    """Whether the joint is small enough to be spoken of in mN m: a hand's is, an arm's is not."""
    return float(np.ptp(found.signals.torque)) < 1.0


def as_json(found: Identification) -> dict[str, Any]:
    """The JSON object of `hil identify --json`, SI units; what is not a finite number is null."""
    return {
        "schema": SCHEMA,
        "recordings": [str(path) for path in found.recordings],
        "model": found.model.name,
        "preset": found.preset,
        "seed": found.seed,
        "parameters": {estimate.name: _parameter(estimate) for estimate in found.estimates},
        "fitness": {
            "value": found.fitness,
            "exact_optimum": found.optimum,
            "relative_gap": found.optimiser_gap,
            "unit": "N*m",
        },
        "samples": found.samples,
        "trials": len(found.trials.fitness),
        "evaluations": found.trials.evaluations,
        "seconds": found.seconds,
        "holdout": {"fitness": _number(found.validation.fitness), "nrmse": _number(found.validation.nrmse)},
        "warnings": [diagnostic.as_json() for diagnostic in found.diagnostics],
        "ladder": [_rung(rung) for rung in found.steps],
        "fixture": None if found.fixture is None else _fixture(found.fixture),
    }


def _fixture(fixture: Fixture) -> dict[str, Any]:
    return {
        "recording": str(fixture.recording),
        "model": fixture.model,
        "parameters": {estimate.name: _parameter(estimate) for estimate in fixture.estimates},
    }


def unusable_json(recordings: Sequence[Path], model: str, preset: str, seed: int, reason: str) -> dict[str, Any]:
    """The same object where nothing could be fitted: Kc and Bc are null and not identifiable, and `reason` says why."""
    units = {"Kc": "N*m/rad", "Bc": "N*m*s/rad"}
    return {
        "schema": SCHEMA,
        "recordings": [str(path) for path in recordings],
        "model": model,
        "preset": preset,
        "seed": seed,
        "parameters": {
            name: {"value": None, "unit": unit, "ci95": [None, None], "identifiable": False}
            for name, unit in units.items()
        },
        "warnings": [Diagnostic("unusable", reason, name).as_json() for name in units],
    }


def _parameter(estimate: Estimate) -> dict[str, Any]:
    return {
        "value": estimate.optimiser.best,
        "unit": estimate.unit,
        "ci95": [_number(end) for end in estimate.ci95],
        "exact": estimate.value,
        "trials_mean": estimate.optimiser.mean,
        "trials_std": _number(estimate.optimiser.std),
        "identifiable": estimate.identifiable,
        "at_bound": estimate.at_bound,
        "bounds": [_number(end) for end in estimate.bounds],
        "within_std": None if estimate.components is None else estimate.components.within,
        "between_std": None if estimate.components is None else estimate.components.between,
    }


def _rung(rung: Rung) -> dict[str, Any]:
    return {
        "model": rung.model,
        "term": rung.term,
        "taken": rung.taken,
        "fitness": rung.fitness,
        "held_out": rung.held_out,
        "gain": _number(rung.gain),
        "Kc": rung.Kc,
        "Bc": rung.Bc,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def headline(found: Identification) -> str:
    """Return Kc and Bc with half of their 95 % intervals, in one line."""
    parts = []
    for estimate in found.estimates[:2]:
        factor, unit = people_unit(estimate.unit, milli=_milli(found))
        half = 0.5 * (estimate.ci95[1] - estimate.ci95[0]) * factor
        known = estimate.identifiable and math.isfinite(half)
        interval = f"± {half:.1g} {unit}" if known else f"{unit} (not identifiable)"
        parts.append(f"{estimate.name} = {estimate.value * factor:#.4g} {interval}")
    return ",  ".join(parts)


def estimates_table(found: Identification) -> Table:
    """Return the table of values and 95 % intervals."""
    rows = []
    for estimate in found.estimates:
        factor, unit = people_unit(estimate.unit, milli=_milli(found))
        low, high = (end * factor for end in estimate.ci95)
        interval = f"{low:.5g} to {high:.5g}" if math.isfinite(low) else "not identifiable"
        name = estimate.name if estimate.identifiable else f"{estimate.name} (not identifiable)"
        rows.append((name, f"{estimate.value * factor:.5g}", interval, unit))
    return _table(f"{found.model.name}, {found.samples} samples", ("value", "95 % interval"), rows)


def repeatability_table(found: Identification) -> Table:
    """Return the table of optimiser repeatability: the paper's Table 1 beside the exact optimum. No uncertainty."""
    rows = []
    for estimate in found.estimates:
        factor, unit = people_unit(estimate.unit, milli=_milli(found))
        std = (
            f" ± {estimate.optimiser.std * factor:.0e}" if math.isfinite(estimate.optimiser.std) else ""
        )  # of one trial: none
        trials = f"{estimate.optimiser.best * factor:.5g}", f"{estimate.optimiser.mean * factor:.5g}{std}"
        rows.append((estimate.name, *trials, f"{estimate.value * factor:.5g}", unit))
    title = f"optimiser repeatability, {len(found.trials.fitness)} trials"
    return _table(title, ("best trial", "mean ± std", "exact"), rows)


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    from rich.box import SIMPLE
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), box=SIMPLE, pad_edge=False)
    for heading in ("", *headings, ""):
        table.add_column(heading, justify="right" if heading else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def ladder_table(found: Identification) -> Table:
    """The ladder of models: what each term gains, and what it does to Kc and Bc."""
    from rich.box import SIMPLE
    from rich.table import Table

    milli = _milli(found)
    torque, kc, bc = (people_unit(unit, milli=milli) for unit in ("N*m", "N*m/rad", "N*m*s/rad"))
    table = Table(title="model selection", box=SIMPLE, pad_edge=False)
    for heading in ("term", f"error, {torque[1]}", "held-out", "gain", f"Kc, {kc[1]}", f"Bc, {bc[1]}", ""):
        table.add_column(heading, justify="right" if heading not in {"term", ""} else "left")
    for rung in found.steps:
        table.add_row(
            rung.term if rung.term == "linear" else f"+ {rung.term}",
            f"{rung.fitness * torque[0]:.4g}",
            f"{rung.held_out * torque[0]:.4g}",
            f"{rung.gain:.3g}" if math.isfinite(rung.gain) else "",
            f"{rung.Kc * kc[0]:.5g}",
            f"{rung.Bc * bc[0]:.4g}",
            "included" if rung.taken else "rejected",
        )
    return table


def identification_lines(found: Identification) -> list[str]:
    """What the table does not say: the fitness and its gap, the held-out part, the work done."""
    factor, unit = people_unit("N*m", milli=_milli(found))
    return [
        f"mean |torque error| {found.fitness * factor:.5g} {unit}; exact minimum {found.optimum * factor:.5g} {unit}; "
        f"optimiser gap {found.optimiser_gap:.1e}",
        f"validation on 20 % held-out data: {found.validation.fitness * factor:.3g} {unit}; "
        f"RMS {found.validation.nrmse:.2%} of the torque's",
        *_scatter_lines(found),
        *_fixture_lines(found),
        *([] if found.steps else ["the intervals assume this model: --model auto selects its terms from the data"]),
        f"excited band {found.signals.band[0]:.2g} to {found.signals.band[1]:.3g} Hz; "
        f"{found.trials.evaluations} evaluations in {found.seconds:.2f} s",
    ]


def _scatter_lines(found: Identification) -> list[str]:
    """What pooled recordings say of Kc and Bc: how far one is from another, beside its own error."""
    told = [(estimate, estimate.components) for estimate in found.estimates[:2] if estimate.components is not None]
    return [
        f"{estimate.name}, standard deviation between the {len(found.recordings)} recordings: "
        f"{scatter.between * factor:.2g} {unit}; within one: {scatter.within * factor:.2g} {unit}"
        for estimate, scatter in told
        for factor, unit in [people_unit(estimate.unit, milli=_milli(found))]
    ]


def _fixture_lines(found: Identification) -> list[str]:
    """What was taken off Kc and Bc."""
    if found.fixture is None:
        return []
    told = [
        f"{estimate.name} {estimate.value * factor:.4g} {unit}"
        for estimate in found.fixture.estimates
        for factor, unit in [people_unit(estimate.unit, milli=_milli(found))]
    ]
    return [f"without the fixture of {found.fixture.recording}, {' and '.join(told)}"]


def inspection_table(seen: Inspection) -> Table:
    """What a recording holds, a line each."""
    from rich.table import Table
    from rich.text import Text

    # a name is shown as it is: "[red]" in it is no colour
    table = Table(title=Text(f"{seen.path}: {seen.kind}, {seen.end_reason}"), show_header=False)
    factor, unit = people_unit("N*m", milli=seen.torque < 1.0)
    rows: Mapping[str, str] = {
        "samples": f"{seen.samples} over {seen.duration:.3g} s",
        "rate": f"{seen.rate:.5g} Hz, 99 % of intervals within {seen.jitter * 1e6:.3g} us of it",
        "lost, NaN, late": f"{seen.lost}, {seen.not_numbers}, {seen.late}; longest gap {seen.longest_gap * 1e3:.3g} ms",
        "saturated": f"{seen.saturated} rows",
        "deflection": f"{seen.deflection:.4g} rad peak to peak, smallest step {seen.deflection_lsb:.2g} rad",
        "torque": f"{seen.torque * factor:.4g} {unit} peak to peak, from {seen.torque_from}",
        "torque noise": f"{seen.torque_noise * factor:.3g} {unit}; signal to noise {seen.snr:.0f} dB",
        "excited band": f"{seen.band[0]:.3g} to {seen.band[1]:.3g} Hz (99 % of the rate's power)",
        "rate from": f"a local polynomial over {seen.rate_window * 1e3:.3g} ms" if seen.rate_window else "the file",
    }
    for name, text in rows.items():
        table.add_row(name, Text(text))
    return table


def inspection_json(seen: Inspection) -> dict[str, Any]:
    """The JSON object of `hil inspect --json`, SI units."""
    plain = {name: getattr(seen, name) for name in seen.__slots__ if name not in {"path", "diagnostics"}}
    plain["snr"] = _number(seen.snr)
    return {
        "schema": "hil-inspection/1",
        "recording": str(seen.path),
        "usable": seen.usable,
        **plain,
        "warnings": [diagnostic.as_json() for diagnostic in seen.diagnostics],
    }


def draw(found: Identification, path: Path) -> None:
    """Write a PNG: torque and its model over time, what is left, and the loop of torque against deflection.

    Raises WrongUse where the file cannot be written.
    """
    from matplotlib.figure import Figure

    signals = found.signals
    model = _modelled(found)
    factor, unit = people_unit("N*m", milli=_milli(found))
    figure = Figure(figsize=(10, 6), layout="constrained")
    panels = figure.subplot_mosaic([["torque", "loop"], ["left", "loop"]], width_ratios=[3, 2], height_ratios=[2, 1])
    time = signals.motion.time
    panels["torque"].plot(time, signals.torque * factor, lw=0.8, color="0.65", label="measured")
    panels["torque"].plot(time, model * factor, lw=0.6, color="C0", label=found.model.name)
    panels["torque"].set(ylabel=f"torque at the joint [{unit}]", title=headline(found))
    panels["torque"].legend(loc="upper right")
    panels["left"].plot(time, (signals.torque - model) * factor, lw=0.4, color="C3")
    panels["left"].set(xlabel="time [s]", ylabel=f"error [{unit}]")
    panels["loop"].plot(signals.motion.dtheta, signals.torque * factor, ".", ms=1, color="0.65")
    panels["loop"].plot(signals.motion.dtheta, model * factor, lw=0.3, color="C0")
    panels["loop"].set(xlabel="deflection [rad]", ylabel=f"torque at the joint [{unit}]")
    for panel in panels.values():
        panel.grid(visible=True, lw=0.3)
    with atomic_write(path, force=True) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def _modelled(found: Identification) -> NDArray[np.float64]:
    signals = found.signals
    values = np.array([estimate.value for estimate in found.estimates])
    shape = values[len(found.model.linear) :]
    columns = found.model.columns(signals.motion, shape)
    known = signals.torque - found.model.target(signals.motion, signals.torque, shape)
    return np.asarray(known + columns @ values[: len(found.model.linear)])


def page_files(path: Path) -> tuple[Path, Path]:
    """The page at `path` and the picture beside it. Raises WrongUse where the two would be one file."""
    picture = path.with_suffix(".png")
    if picture == path:
        raise WrongUse(
            f"{path} is the name of the report's picture: name the page, such as {path.with_suffix('.html')}"
        )
    return path, picture


def write_page(found: Identification, path: Path) -> list[Path]:
    """Write a page that stands alone (`path`, HTML) and its picture beside it; the files written. Raises WrongUse."""
    path, picture = page_files(path)
    draw(found, picture)
    rows = "".join(
        f"<tr><td>{estimate.name}</td><td>{estimate.value * factor:.5g}</td>"
        f"<td>{estimate.ci95[0] * factor:.5g} to {estimate.ci95[1] * factor:.5g}</td><td>{html.escape(unit)}</td>"
        f"<td>{'yes' if estimate.identifiable else 'no'}</td></tr>"
        for estimate in found.estimates
        for factor, unit in [people_unit(estimate.unit, milli=_milli(found))]
    )
    names = html.escape(", ".join(str(recording) for recording in found.recordings))
    said = "".join(f"<li>{html.escape(diagnostic.message)}</li>" for diagnostic in found.diagnostics)
    lines = "".join(f"<p>{html.escape(line)}</p>" for line in identification_lines(found))
    data = base64.b64encode(picture.read_bytes()).decode()
    page = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>hil</title>'
        "<style>body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto}td,th{padding:.2rem 1rem .2rem 0;"
        "text-align:left}img{max-width:100%}</style>"
        f"<h1>{names}</h1><table><tr><th></th><th>value</th><th>95 % interval</th><th>unit</th>"
        f"<th>identifiable</th></tr>{rows}</table>{lines}<ul>{said}</ul>"
        f'<img alt="measured and modelled torque" src="data:image/png;base64,{data}"></html>\n'
    )
    with atomic_write(path, force=True) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return [path, picture]
