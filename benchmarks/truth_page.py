"""The figures of the truth study and the files of results/ that hold them, with a picture."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from page import RESULTS, machine, write_result
from scipy.stats import binom
from truth_cases import BC, CASES, KC, Array, Case, bound
from truth_recordings import SOURCES

TRUE = {"Kc": KC, "Bc": BC}
UNIDENTIFIABLE = "unidentifiable"

# mean and worst error, %, and the range of the coverage, %: the promise's table; a wide row has one bar for both
BARS = {
    "tight": {"Kc": (0.2, 0.5), "Bc": (0.5, 2.0), "coverage": (93.0, 97.0)},
    "wide": {"Kc": (0.5, 0.5), "Bc": (2.0, 2.0), "coverage": (90.0, 98.0)},
}
SPREAD_BAR = 1.3  # of the clean case, over the bound
BEYOND, WRONG = 1.5, 0.02  # times half the interval; share that may be confidently wrong

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Figures:
    """One parameter in one case. mean, worst, spread, plain_mean, plain_worst: % of the truth; worst are magnitudes.

    over_bound: the spread over the Cramer-Rao bound. coverage, low, high: % of the intervals that hold the truth, and
    the 95 % interval of that share (Wilson 1927). count: results that have a value.
    """

    count: int
    mean: float
    worst: float
    spread: float
    over_bound: float
    coverage: float
    low: float
    high: float
    plain_mean: float
    plain_worst: float


def figures(name: str, case: Case, rows: list[Row]) -> Figures:
    """The figures of parameter `name`, NaN where no row has a value."""
    true = TRUE[name]
    found = [row[name] for row in rows if _has(row, name)]
    errors = _percent([one["value"] for one in found], true)
    plain = _percent([row["plain"][name] for row in rows], true)
    held = [one["ci95"] is not None and one["ci95"][0] <= true <= one["ci95"][1] for one in found]
    spread = float(np.std(errors, ddof=1)) if len(errors) > 1 else math.nan
    return Figures(
        count=len(errors),
        mean=float(np.mean(errors)) if len(errors) else math.nan,
        worst=float(np.abs(errors).max()) if len(errors) else math.nan,
        spread=spread,
        over_bound=spread / (100.0 * bound(case)[name] / true),
        coverage=100.0 * sum(held) / len(held) if held else math.nan,
        **dict(zip(("low", "high"), wilson(sum(held), len(held)), strict=True)),
        plain_mean=float(np.mean(plain)) if len(plain) else math.nan,
        plain_worst=float(np.abs(plain).max()) if len(plain) else math.nan,
    )


def _has(row: Row, name: str) -> bool:
    """Whether the parameter has a value: nothing at all can be said of a recording where nothing moved."""
    return row.get(name, {}).get("value") is not None


def _percent(values: list[float], true: float) -> Array:
    return 100.0 * (np.array(values, dtype=np.float64) / true - 1.0)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """The 95 % interval, %, of a share of which `hits` of `count` were seen."""
    if not count:
        return math.nan, math.nan
    z, share = 1.959964, hits / count
    middle = (share + z * z / (2 * count)) / (1.0 + z * z / count)
    half = z * math.sqrt(share * (1.0 - share) / count + z * z / (4 * count * count)) / (1.0 + z * z / count)
    return 100.0 * (middle - half), 100.0 * (middle + half)


def misses(case: Case, name: str, found: Figures) -> list[str]:
    """What of the promise's bars one parameter of a case does not reach."""
    bars = BARS[case.bars]
    mean, worst = bars[name]
    low, high = bars["coverage"]
    missed = []
    if not abs(found.mean) < mean:
        missed.append(f"{name} mean")
    if not found.worst < worst:
        missed.append(f"{name} worst")
    if not low <= found.coverage <= high:
        missed.append(f"{name} coverage")
    if case.name == "clean" and not found.over_bound <= SPREAD_BAR:
        missed.append(f"{name} spread")
    return missed


def error_line(case: Case, source: str, rows: list[Row]) -> str:
    """The line of a case whose recordings tell both parameters."""
    cells, missed = [f"| {case.name} | {source} | {len(rows)}"], []
    if sum(_has(row, "Kc") for row in rows) < len(rows):
        missed.append("not every recording gave a result")
    if any(row["status"] for row in rows):
        missed.append("exit not 0")
    for name in TRUE:
        found = figures(name, case, rows)
        missed += misses(case, name, found)
        cells += [
            f"{found.mean:+.3f}",
            f"{found.worst:.2f}",
            f"{found.spread:.3f} ({found.over_bound:.2f})",
            f"{found.coverage:.1f} ({found.low:.1f}-{found.high:.1f})",
        ]
    by_hand = [figures(name, case, rows) for name in TRUE]
    cells += [f"{one.plain_mean:+.2f}, {one.plain_worst:.2f}" for one in by_hand]
    return " | ".join([*cells, "pass" if not missed else "miss: " + ", ".join(missed)]) + " |"


def unidentifiable_line(case: Case, source: str, rows: list[Row]) -> str:
    """The line of a case that must be found not identifiable, with exit 1."""

    def share(hits: int) -> str:
        return f"{100.0 * hits / len(rows):.1f}"

    identified = {name: sum(row.get(name, {}).get("identifiable", False) for row in rows) for name in TRUE}
    ones = sum(row["status"] == 1 for row in rows)
    silent = identified["Bc"] if case.name == "too slow" else max(identified.values())
    passed = ones == len(rows) and silent == 0
    cells = [
        case.name,
        source,
        str(len(rows)),
        share(len(rows) - identified["Kc"]),
        share(len(rows) - identified["Bc"]),
    ]
    return f"| {' | '.join([*cells, share(ones), 'pass' if passed else 'miss'])} |"


def chosen_line(case: Case, source: str, rows: list[Row]) -> str:
    """The line that says which models were chosen, what was warned of, and how long it took."""

    def shares(names: list[str]) -> str:
        common = Counter(names).most_common(4)
        return ", ".join(f"{name or 'none'} {100.0 * count / len(rows):.0f} %" for name, count in common) or "-"

    warned = shares([code for row in rows for code in row["codes"]])
    ones = 100.0 * sum(row["status"] != 0 for row in rows) / len(rows)
    median = float(np.median([row["seconds"] for row in rows]))
    models = shares([row["model"] for row in rows])
    wrong = sum(is_confidently_wrong(row) for row in rows)
    return f"| {case.name} | {source} | {models} | {ones:.1f} | {wrong} | {warned} | {median:.2f} |"


def is_confidently_wrong(row: Row) -> bool:
    """Whether a result ends with 0 and warns of no misfit, but the truth is outside 1.5 times an interval of it."""
    if row["status"] or "misfit" in row["codes"]:
        return False
    return any(_is_beyond(row[name]["ci95"], true) for name, true in TRUE.items() if _has(row, name))


def _is_beyond(stated: list[float] | None, true: float) -> bool:
    return stated is not None and abs(true - 0.5 * sum(stated)) > BEYOND * 0.5 * (stated[1] - stated[0])


def most_by_chance(count: int) -> int:
    """The most of `count` results that may be confidently wrong where 2 % of them are: more come once in 100 times."""
    return int(binom.ppf(0.99, count, WRONG))


ERROR_HEAD = (
    "| case | source | runs | Kc mean | worst | spread (bound) | coverage | Bc mean | worst | spread (bound) "
    "| coverage | plain Kc | plain Bc | bars |\n|" + " --- |" * 14
)
UNIDENTIFIABLE_HEAD = (
    "| case | source | runs | Kc not identifiable, % | Bc not identifiable, % | exit 1, % | bar |\n|" + " --- |" * 7
)
CHOSEN_HEAD = (
    "| case | source | models chosen | exit not 0, % | confidently wrong | warned of | seconds, median |\n|"
    + " --- |" * 7
)
STUDY = """\
`python benchmarks/truth.py` records every case many times, from sources that share nothing: the simulated stand through
the recorder; a closed form (a prescribed deflection, its exact derivatives, the torque from them); and MuJoCo's hinge
with its own spring, damper and dry friction, where it has what the case asks for, read by the sensors of the closed
form. Kc 17.75 mN m/rad, Bc 0.19 mN m s/rad, 500 Hz, 20 s, chirp of 0.35 rad from 0.1 to 15 Hz, torque noise of 0.2
mN m; results go to a file and a study that was stopped goes on. But for what a case names the simulated stand has no
friction, a rigid fixture, 2^24 counts, no delay, no jitter and no loss; it is driven in position with a fade in and out
of 0.1 s (`benchmarks/truth_cases.py` has every number). `--short` takes 20 minutes on two cores and goes on with the
benches of `truth_benches.py`."""
CASES_HEAD = "| case | what is wrong | simulator | closed form |\n| --- | --- | --- | --- |"

EXPLANATION = """\
Mean, worst (largest magnitude) and spread (standard deviation) of the error in %; in brackets the spread over the
Cramer-Rao bound of the case's own model for Gaussian noise, exact angles and exact instants, worked out from the closed
form. Coverage: how many % of the 95 % intervals hold the truth, and the 95 % interval of that share itself. Plain: mean
and worst error of least squares on the angle and its `numpy.gradient` on the same files. A bar is passed where the
mean, the worst error and the coverage of both parameters are within what is asked for, with exit 0 every time: mean 0.2
and 0.5 %, worst 0.5 and 2 %, coverage 93 to 97 %; for backlash, cubic, motor side and all at once mean and worst 0.5
and 2 %, coverage 90 to 98 %; for clean also 1.3 times the bound."""


def tables(model: str, rows: list[Row]) -> str:
    """The section on one model as Markdown."""
    groups = [
        (case, source, chosen)
        for case in CASES
        for source in SOURCES
        if (chosen := [row for row in rows if (row["case"], row["source"]) == (case.name, source)])
    ]
    identifiable = [error_line(*group) for group in groups if group[0].bars != UNIDENTIFIABLE]
    unidentifiable = [unidentifiable_line(*group) for group in groups if group[0].bars == UNIDENTIFIABLE]
    return "\n\n".join(
        [
            f"## `--model {model}`",
            f"{machine()}.",
            EXPLANATION,
            "\n".join([ERROR_HEAD, *identifiable]),
            "\n".join([UNIDENTIFIABLE_HEAD, *unidentifiable]),
            "\n".join([CHOSEN_HEAD, *(chosen_line(*group) for group in groups)]),
        ]
    )


def cases_section() -> str:
    """What each case is, from each source."""
    lines = [f"| {case.name} | {case.what} | {case.in_sim} | {case.in_closed_form} |" for case in CASES]
    return "\n\n".join(
        [
            "## The study",
            STUDY,
            "\n".join([CASES_HEAD, *lines]),
        ]
    )


def picture_name(model: str) -> str:
    return f"truth-{model.replace('+', '-')}.png"


def draw(model: str, rows: list[Row]) -> None:
    """The errors of every identifiable case, 5 to 95 % as a bar, the worst as dots, logarithmic beyond 0.1 %."""
    from matplotlib.figure import Figure

    shown = [case for case in CASES if case.bars != UNIDENTIFIABLE]
    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    for axes, (name, true) in zip(figure.subplots(2, 1, sharex=True), TRUE.items(), strict=True):
        for shift, source in zip((-0.25, 0.0, 0.25), SOURCES, strict=True):
            colour = f"C{round(4.0 * shift) + 1}"
            for place, case in enumerate(shown):
                chosen = [
                    row for row in rows if (row["case"], row["source"]) == (case.name, source) and _has(row, name)
                ]
                errors = _percent([row[name]["value"] for row in chosen], true)
                if len(errors):
                    low, middle, high = np.quantile(errors, [0.05, 0.5, 0.95])
                    axes.plot([place + shift] * 2, [low, high], color=colour, linewidth=6, alpha=0.5)
                    axes.plot([place + shift] * 3, [errors.min(), middle, errors.max()], ".", color=colour)
            axes.plot([], [], color=colour, linewidth=6, alpha=0.5, label=source)
        axes.set_yscale("symlog", linthresh=0.1)
        axes.axhline(0.0, color="black", linewidth=0.5)
        axes.set_ylabel(f"error of {name}, %")
    axes.set_xticks(range(len(shown)), [case.name for case in shown], rotation=20)
    figure.axes[0].legend()
    figure.axes[0].set_title(f"hil identify --model {model}: 5 to 95 % (bars), median and extremes (dots)")
    RESULTS.mkdir(exist_ok=True)
    figure.savefig(RESULTS / picture_name(model), dpi=110)


def write_page(model: str, rows: list[Row]) -> str:
    """Write the sections on the study and on this model and the picture; the model's section."""
    text = tables(model, rows)
    write_result("truth-cases", cases_section())
    write_result(f"truth-{model.replace('+', '-')}", text)
    draw(model, rows)
    return text
