"""The repetition of the paper's experiment by `hil replicate`: Table 1, Figure 8 and the JSON object."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.identification.replicate import PAPER
from hil.report.formatting import Section, diagnostics_json, json_number
from hil.report.html_page import Page, Picture, write
from hil.report.pictures.search import convergence_chart, convergence_text
from hil.report.provenance import provenance

if TYPE_CHECKING:
    from hil.identification.replicate import Replication
    from hil.identification.result import Estimate

SCHEMA = "hil-replication/2"
"""The name and version of the JSON object. In version 1 the optimiser gap was named relative_gap, and there were no
diagnostics.
"""


def as_json(done: Replication) -> dict[str, Any]:
    """Return the JSON object of `hil replicate --json`, SI units."""
    found = done.identification
    return {
        "schema": SCHEMA,
        "recording": str(found.recordings[0]),
        "samples": found.samples,
        "trials": len(found.trials.fitness),
        "evaluations": found.trials.evaluations,
        "seconds": found.search_seconds,
        "processor_seconds": found.trials.processor_seconds,
        "workers": done.workers,
        "evaluations_per_second": done.evaluations_per_second,
        "numpy_seconds_per_evaluation": done.numpy_seconds,
        "ratio_to_numpy": done.ratio_to_numpy,
        "optimiser_gap": found.optimiser_gap,
        "interrupted": found.trials.interrupted,
        "parameters": {estimate.name: _parameter(done, estimate) for estimate in found.estimates},
        **diagnostics_json(found.diagnostics),
    }


def _parameter(done: Replication, estimate: Estimate) -> dict[str, Any]:
    mean, std = PAPER[estimate.name]
    return {
        "unit": estimate.unit,
        "true": done.truth[estimate.name],
        "value": estimate.value,
        "best": estimate.optimiser.best,
        "trials_mean": estimate.optimiser.mean,
        "trials_std": json_number(estimate.optimiser.std),
        "paper_mean": mean,
        "paper_std": std,
    }


def replication_lines(done: Replication) -> list[str]:
    """Return Table 1 beside the paper's Table 1, in mN m; each row of the table is one line."""
    return [f"{name:36}{first:>20}{second:>22}" for name, first, second in _rows(done)]


def _rows(done: Replication) -> list[tuple[str, str, str]]:
    kc, bc = done.identification.estimates
    kc_trials, bc_trials = (_mean(one.optimiser.mean, one.optimiser.std) for one in (kc, bc))
    return [
        ("", "Kc [mN m/rad]", "Bc [mN m s/rad]"),
        ("real parameters (simulated stand)", f"{done.truth['Kc'] * 1e3:.2f}", f"{done.truth['Bc'] * 1e3:.3f}"),
        ("best of the trials", f"{kc.optimiser.best * 1e3:.4f}", f"{bc.optimiser.best * 1e3:.5f}"),
        ("trials, mean ± std", kc_trials, bc_trials),
        ("the paper's, mean ± std", _mean(*PAPER["Kc"]), _mean(*PAPER["Bc"])),
        ("exact optimum of these data", f"{kc.value * 1e3:.4f}", f"{bc.value * 1e3:.5f}"),
    ]


def _mean(mean: float, std: float) -> str:
    spread = f" ± {std * 1e3:.2g}" if math.isfinite(std) else ""  # a single trial has none
    return f"{mean * 1e3:.4g}{spread}"


def write_page(done: Replication, path: Path) -> None:
    """Write Table 1 and Figure 8 as an HTML page: the best fitness of every trial over the generations.

    Raises WrongUse if the file cannot be written.
    """
    found = done.identification
    page = Page(
        title="The paper's experiment, repeated",
        subject=f"Identification of {found.recordings[0]} by the paper's genetic algorithm",
        verdict=[f"Trials, mean ± std: Kc {_rows(done)[3][1]} mN m/rad, Bc {_rows(done)[3][2]} mN m s/rad"],
        diagnostics=found.diagnostics,
        sections=[Section("Table 1", _rows(done))],
        pictures=[
            Picture(
                "convergence",
                "Figure 8",
                convergence_text(found),
                lambda: convergence_chart(found.trials, found.optimum, 1e3, "mN m"),
            )
        ],
        provenance=provenance(found.recordings, "hil replicate"),
        table=as_json(done),
    )
    write(page, path, force=True)
