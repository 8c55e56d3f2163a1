"""The truth study: does the identification say what is true, and do its intervals hold? `python benchmarks/truth.py`.

Every case of `truth_cases` is recorded `--seeds` times by the simulated stand and as often written from a closed form;
each recording is identified as `hil identify --json --model MODEL` does it, and by plain least squares with a gradient.
Results are appended to a file of JSON lines, one recording each, so that a study that was stopped goes on where it was;
the file's name carries the fingerprint of the code that it judges. The tables and a picture go into results/.

`--short` takes a few seeds and goes on with the benches of `truth_benches.py`; it writes no page. Either ends with 1
where more of a case or bench is confidently wrong than chance explains with 2 % of it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import truth_benches
from results import append, rows_of, usual_place
from truth_cases import CASES, RATE, case_named
from truth_page import UNIDENTIFIABLE, is_confidently_wrong, most_by_chance, tables, write_page
from truth_recordings import SOURCES, can_make

from drivers.servo import Status
from hil.cli import app as cli
from hil.signals.source import open_sources

SEEDS, SHORT = 500, 6
SCRIPTS = (
    "truth.py",
    "truth_cases.py",
    "truth_mujoco.py",
    "mujoco_joint.py",
    "truth_recordings.py",
)  # that make the recordings
UNIDENTIFIABLE_PART = 5  # one seed in so many also makes the recordings that cannot identify the parameters


class Job(NamedTuple):
    """One recording to identify. Seed-major order, so that a study that is stopped has every case equally often."""

    seed: int
    source: str
    case: str
    model: str


def estimate(path: Path, model: str) -> dict[str, Any]:
    """What `hil identify` says of a recording: the one place that knows how it is asked.

    status: the command's. model: the one chosen, "" where there is no result. Kc, Bc: value, ci95, standard_error (from
    the interval where it is not given) in SI and identifiable. codes: of the warnings.
    """
    heard, said = io.StringIO(), io.StringIO()
    began = time.perf_counter()
    with contextlib.redirect_stdout(heard), contextlib.redirect_stderr(said):
        status = cli.run(["identify", str(path), "--json", "--workers", "1", "--trials", "1", "--model", model])
    seconds = time.perf_counter() - began
    if not heard.getvalue():
        return {"status": status, "model": "", "codes": [], "seconds": seconds, "said": said.getvalue().strip()[-200:]}
    found = json.loads(heard.getvalue())
    return {
        "status": status,
        "model": found["model"],
        "codes": sorted({warning["code"] for warning in (*found["warnings"], *found["errors"])}),
        "seconds": seconds,
        **{name: _parameter(found["parameters"][name]) for name in ("Kc", "Bc")},
    }


def _parameter(said: dict[str, Any]) -> dict[str, Any]:
    low, high = said["ci95"]
    known = low is not None and high is not None
    width = (high - low) / (2.0 * 1.959964) if known else None
    return {
        "value": said["value"],
        "ci95": [low, high] if known else None,
        "standard_error": said.get("standard_error", width),
        "identifiable": said["identifiable"],
    }


def plain(path: Path) -> dict[str, float]:
    """Kc and Bc, SI, by least squares on the angle and its `numpy.gradient`, as one would do it by hand.

    Lost rows are dropped. Torque of the motor is taken through equation 1 with gradients of gradients.
    """
    with open_sources([path]) as (source,):
        stand = source.table
        channels = {name: source.recording.channel(name) for name in ("read_time", "dtheta", "torque", "status")}
    answered = (channels["status"].astype(np.int64) & int(Status.NO_REPLY | Status.BAD_REPLY)) == 0
    when, angle, torque = (channels[name][answered] for name in ("read_time", "dtheta", "torque"))
    rate = np.gradient(angle, when)
    if stand is not None and stand.torque_source == "motor":
        square = stand.gear_ratio**2
        torque = torque - square * (stand.motor_inertia * np.gradient(rate, when) + stand.motor_damping * rate)
    found = np.linalg.lstsq(np.stack([angle, rate], axis=1), torque, rcond=None)[0]
    return {"Kc": float(found[0]), "Bc": float(found[1])}


def judge(job: Job) -> dict[str, Any]:
    """One row of the results: the recording is made, identified and thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.h5"
        SOURCES[job.source](case_named(job.case), job.seed, path)
        return {**job._asdict(), "asked": job.model, **estimate(path, job.model), "plain": plain(path)}


def missing(rows: list[dict[str, Any]], wanted: list[Job]) -> list[Job]:
    """The jobs that no row answers, in their order."""
    done = {(row["seed"], row["source"], row["case"], row["asked"]) for row in rows}
    return [job for job in wanted if tuple(job) not in done]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Monte Carlo truth study of hil identify")
    parser.add_argument("--model", default="auto", help="as hil identify takes it")
    parser.add_argument("--seeds", type=int, help=f"recordings of each case from each source: {SEEDS} where not given")
    parser.add_argument("--short", action="store_true", help=f"{SHORT} seeds, then the benches; no page is written")
    parser.add_argument("--case", action="append", choices=[case.name for case in CASES], help="only these")
    parser.add_argument("--source", action="append", choices=list(SOURCES), help="only these")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--results", type=Path, help="file of JSON lines; otherwise one in the temporary folder")
    return parser.parse_args()


def wanted_jobs(options: argparse.Namespace, seeds: int) -> list[Job]:
    """The recordings of the study, seed by seed."""
    return [
        Job(seed, source, case.name, options.model)
        for seed in range(seeds)
        for case in CASES
        for source in options.source or SOURCES
        if case.name in (options.case or [case.name])
        and can_make(source, case)
        and (case.bars != UNIDENTIFIABLE or seed * UNIDENTIFIABLE_PART < seeds)  # a few suffice
    ]


def breaches(rows: list[dict[str, Any]]) -> list[str]:
    """A sentence for each case and source with more confidently wrong results than 2 % and chance explain."""
    found = []
    for case, source in sorted({(row["case"], row["source"]) for row in rows}):
        mine = [row for row in rows if (row["case"], row["source"]) == (case, source)]
        wrong = [row["seed"] for row in mine if is_confidently_wrong(row)]
        if len(wrong) > most_by_chance(len(mine)):
            found.append(f"{case}, {source}: {len(wrong)} of {len(mine)} are confidently wrong: seeds {wrong}")
    return found


def main() -> None:
    options = _options()
    results = options.results or usual_place(options.model, *SCRIPTS)
    wanted = wanted_jobs(options, options.seeds or (SHORT if options.short else SEEDS))
    jobs = missing(rows_of(results), wanted)
    print(f"{len(wanted)} recordings of {RATE:g} Hz, {len(wanted) - len(jobs)} done before; results in {results}")
    if jobs:
        append(judge, jobs, options.workers, results)
    asked = {tuple(job) for job in wanted}
    rows = [row for row in rows_of(results) if (row["seed"], row["source"], row["case"], row["asked"]) in asked]
    print(tables(options.model, rows) if options.short else write_page(options.model, rows))
    broken = breaches(rows)
    if options.short:
        broken += truth_benches.short(options.workers)
    print("\n".join(broken) or "no promise is broken")
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()
