"""Is `hil identify` ever confidently wrong on the benches people have? `python benchmarks/truth_benches.py`.

Each bench of `benches`, one with two effects drawn at random for each seed, and the default simulated stand as the
README's command records it, is recorded `--seeds` times and identified as `hil identify REC.h5 --json` does it. A
result is confidently wrong where the command ends with 0, warns of no misfit, and Kc or Bc is further from the truth
than 1.5 times half its interval. The table of all results in the file goes into results/benches.csv; a study that was
stopped goes on. `--short` takes few seeds; both end with 1 where a bench breaks a promise: at most 2 % of a bench
confidently wrong, and at most 1 % of the benches that a model describes flagged as misfit.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import default_stand
import numpy as np
from benches import DESCRIBED, MUJOCO, ROWS, Bench, drawn, record, write_csv, write_recording
from page import machine, write_result
from results import append, rows_of, usual_place
from truth_page import BEYOND, most_by_chance

from hil.cli import app as cli

SEEDS, SHORT = 200, 3
SCRIPTS = ("truth_benches.py", "benches.py", "mujoco_joint.py", "default_stand.py")
ALARMS = 0.01  # share that is allowed
BENCHES = {**DESCRIBED, **ROWS}
COLUMNS = ("--time", "time", "--torque", "torque", "--dtheta", "dtheta")
DRAWN = "two effects drawn"  # a bench of its own for each seed
STAND = "default stand"  # recorded by hil itself
NAMES = (*BENCHES, DRAWN, STAND)
EXPLANATION = """\
`python benchmarks/truth_benches.py` records each bench (`benchmarks/benches.py`: 0.3 N m/rad, 3 mN m s/rad, 500 Hz,
20 s, a multisine of 0.25 rad and 1 mN m of noise, but for what its name says) and identifies it unasked. MuJoCo: it
simulates the joint, which a servo moves, and its springs, damping and friction. Errors: the median, and the median of
half the interval. Confidently wrong: exit status 0, no `misfit`, and the truth outside 1.5
times an interval."""


class Job(NamedTuple):
    """One recording to identify, by the name of its bench."""

    seed: int
    bench: str


def identified(path: Path) -> dict[str, Any]:
    """Return what `hil identify` says of a recording: status, model, codes, and value and ci95 of Kc and Bc."""
    output, messages = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(messages):
        status = cli.run(["identify", str(path), "--json", "--workers", "1", "--trials", "1"])
    found = json.loads(output.getvalue()) if output.getvalue() else {}
    said = [*found.get("warnings", []), *found.get("errors", [])]
    return {
        "status": status,
        "model": found.get("model", ""),
        "codes": sorted({one["code"] for one in said}),
        "Kc": _parameter(found, "Kc"),
        "Bc": _parameter(found, "Bc"),
        "message": messages.getvalue().strip()[:100] if not found else "",
    }


def _parameter(found: dict[str, Any], name: str) -> dict[str, float] | None:
    stated = found.get("parameters", {}).get(name)
    if stated is None or None in stated["ci95"]:
        return None
    low, high = stated["ci95"]
    return {"value": 0.5 * (low + high), "half": 0.5 * (high - low)}


def _make(bench: Bench, seed: int, path: Path) -> None:
    """Write the recording of a bench; a wrong unit can only come in by a table, which `hil import` must not accept."""
    if bench.torque_unit == bench.angle_unit == 1.0:
        write_recording(record(bench, seed), path)
        return
    write_csv(record(bench, seed), path.with_suffix(".csv"))
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        cli.run(["import", str(path.with_suffix(".csv")), "-o", str(path), *COLUMNS])


def judge(job: Job) -> dict[str, Any]:
    """Record one bench, identify it and hold the result against the truth."""
    effects, bench = drawn(job.seed) if job.bench == DRAWN else (job.bench, BENCHES.get(job.bench))
    truths = {"Kc": bench.stiffness, "Bc": bench.damping} if bench else default_stand.TRUTH
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.h5"
        if bench:
            _make(bench, job.seed, path)
        else:
            default_stand.record(path, job.seed)
        found = identified(path)
    errors = {name: _error(found[name], truth) for name, truth in truths.items()}
    wrong = any(error is not None and abs(error[0]) > BEYOND * error[1] for error in errors.values())
    flagged = "misfit" in found["codes"]
    return {
        **job._asdict(),
        **found,
        "effects": effects,
        "errors": errors,
        "flagged": flagged,
        "wrong": wrong and found["status"] == 0 and not flagged,
        "seconds": time.perf_counter() - began,
    }


def _error(found: dict[str, float] | None, truth: float) -> tuple[float, float] | None:
    """The error and half the interval, both relative to the truth."""
    return None if found is None else ((found["value"] - truth) / truth, found["half"] / truth)


def table(rows: list[dict[str, Any]]) -> str:
    """Return the results as a table, a bench a line."""
    lines = [
        "| bench | n | model (share) | Kc error | Bc error | exit 0 | misfit | confidently wrong |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in NAMES:
        mine = [row for row in rows if row["bench"] == name]
        if mine:
            lines.append(_line(name, mine))
    return "\n".join(lines)


def _line(name: str, rows: list[dict[str, Any]]) -> str:
    models = [row["model"] for row in rows]
    usual = max(set(models), key=models.count)
    exits = sum(row["status"] == 0 for row in rows)
    flagged, wrong = (sum(row[key] for row in rows) for key in ("flagged", "wrong"))
    return (
        f"| {name} | {len(rows)} | {usual or 'none'} ({models.count(usual)}) | {_typical(rows, 'Kc')} | "
        f"{_typical(rows, 'Bc')} | {exits} | {flagged} | {wrong} |"
    )


def _typical(rows: list[dict[str, Any]], name: str) -> str:
    """The median error with the median of half the interval, in percent."""
    known = [row["errors"][name] for row in rows if row["errors"][name] is not None]
    if not known:
        return "-"
    error, half = (float(np.median([one[at] for one in known])) for at in (0, 1))
    return f"{error:+.2%} ± {half:.2%}"


def breaches(rows: list[dict[str, Any]]) -> list[str]:
    """Return a sentence for each promise that is broken."""
    found = []
    for name in NAMES:
        mine = [row for row in rows if row["bench"] == name]
        wrong = sum(row["wrong"] for row in mine)
        if wrong > most_by_chance(len(mine)):
            which = ", ".join(f"{row['effects']} ({row['seed']})" for row in mine if row["wrong"])
            found.append(f"{name}: {wrong} of {len(mine)} are confidently wrong: {which}")
    described = [row for row in rows if row["bench"] in DESCRIBED]
    alarms = sum(row["flagged"] for row in described)
    if alarms > max(1, ALARMS * len(described)):
        found.append(f"{alarms} of {len(described)} recordings that a model describes are flagged as misfit")
    return found


def page(rows: list[dict[str, Any]]) -> str:
    """Return the section on the benches as Markdown."""
    described = [row for row in rows if row["bench"] in DESCRIBED]
    alarms, wrong = sum(row["flagged"] for row in described), sum(row["wrong"] for row in rows)
    held = " and ".join(_held(rows, name) for name in ("Kc", "Bc"))
    counts = (
        f"{len(rows)} recordings, {wrong} of them confidently wrong; {len(described)} of a bench that a model "
        f"describes, {alarms} of these with a `misfit`. Intervals with exit status 0 held {held}."
    )
    return "\n\n".join(["## Benches", f"{machine()}.", EXPLANATION, counts, table(rows), *breaches(rows)])


def _held(rows: list[dict[str, Any]], name: str) -> str:
    """How often an interval held the truth, where the command ended with 0."""
    errors = [row["errors"][name] for row in rows if row["status"] == 0 and row["errors"][name] is not None]
    return f"{name} in {sum(abs(error) <= half for error, half in errors)} of {len(errors)}"


def short(workers: int) -> list[str]:
    """Record and identify each bench a few times, print their table and return the promises that are broken.

    Those that MuJoCo simulates once only: they are most of the others again.
    """
    results = usual_place("benches", *SCRIPTS)
    jobs = [Job(seed, name) for seed in range(SHORT) for name in NAMES if seed == 0 or not name.endswith(MUJOCO)]
    rows = judged(jobs, workers, results)
    print(table(rows))
    return breaches(rows)


def judged(jobs: Sequence[Job], workers: int, results: Path) -> list[dict[str, Any]]:
    """Return the results of the jobs; those that the file has are not done again."""
    done = {(row["seed"], row["bench"]) for row in rows_of(results)}
    append(judge, [job for job in jobs if tuple(job) not in done], workers, results)
    wanted = {tuple(job) for job in jobs}
    return [row for row in rows_of(results) if (row["seed"], row["bench"]) in wanted]


def main() -> None:
    parser = argparse.ArgumentParser(description="Truth study of hil identify on the benches people have")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="recordings of each bench")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--short", action="store_true", help=f"{SHORT} seeds; no page is written")
    parser.add_argument("--bench", action="append", choices=NAMES, help="only these")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--results", type=Path, help="file of JSON lines; otherwise one in the temporary folder")
    options = parser.parse_args()
    if options.short:
        broken = short(options.workers)
    else:
        results = options.results or usual_place("benches", *SCRIPTS)
        seeds, names = range(options.first, options.first + options.seeds), options.bench or NAMES
        judged([Job(seed, name) for seed in seeds for name in names], options.workers, results)
        rows = rows_of(results)
        write_result("benches", page(rows))
        print(page(rows))
        broken = breaches(rows)
    print("\n".join(broken) or "no promise is broken")
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()
