"""What a revision says of the archive, and whether it may take the place of another one.

    python benchmarks/replay.py FOLDER --write ROWS.csv     identifies the recordings of `archive.py`, one row each
    python benchmarks/replay.py OLD.csv NEW.csv             the table by kind, and the gate: exit status 1 if it fails

Recordings that ROWS.csv has are not identified again, and every part of a run is a fair sample of all kinds. Processor
time is that of this process and its children, with machine code compiled before; `slow` is how much slower the machine
was just then than the one of the reference. A row whose recording took more than 120 s has the status "too long".

Outcome of a parameter that is trusted: right if the truth lies within 1.5 half widths of its 95 % interval; otherwise
confidently wrong, or "off" if there is a `misfit`. Of a recording: the worst of Kc and Bc; untrusted if one that can be
known is not trusted (needless, counted again beside it), or if neither is; "warned" is right with a `misfit`.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import math
import multiprocessing
import os
import shlex
import signal
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

FIELDS = ("file", "kind", "half", "knowable", "status", "model")
FIELDS += tuple(name + what for name in ("Kc", "Bc") for what in ("_true", "", "_half", "_trusted"))
FIELDS += ("codes", "seconds", "slow")
TOO_LONG = 120.0  # s of processor time
BEYOND = 1.5  # half widths
REFERENCE = 0.1025  # s that `slowness` takes on the machine of reference, a Xeon at 2.5 GHz
STAND = "default stand"
WIDER, STAND_WIDER, REFUSALS, SECONDS = 1.3, 1.1, 2.0 / 3.0, 0.5  # new over old, at most
HOLDS = (0.93, 0.98)
OUTCOMES = ("right", "warned", "off", "untrusted", "wrong")

Row = dict[str, str]


class TooLongError(BaseException):  # not an Exception: nothing below may catch it
    """A recording has had its processor time."""


def slowness() -> float:
    """The processor time of a fixed piece of Python and NumPy over that of the machine of reference."""
    import numpy as np

    a, b, y = np.random.default_rng(0).standard_normal((3, 2500))
    began, total = time.process_time(), 0
    for _ in range(5000):
        np.abs(y - 17.0 * a - 0.2 * b).mean()
    for number in range(500_000):
        total += number
    return (time.process_time() - began) / REFERENCE


def identified(path: Path, arguments: Sequence[str] = ()) -> tuple[str, dict[str, Any], float]:
    """The exit status, the object that `hil identify --json` prints ({} if none) and its processor time, s."""
    from hil.cli import app as cli

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise TooLongError

    output, began, status = io.StringIO(), os.times(), "too long"
    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, TOO_LONG)
    silent = contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO())
    with silent[0], silent[1], contextlib.suppress(TooLongError):
        status = str(cli.run(["identify", str(path), "--json", "--workers", "1", "--trials", "1", *arguments]))
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    seconds = sum(os.times()[:4]) - sum(began[:4])
    return status, json.loads(output.getvalue() or "{}") if status != "too long" else {}, seconds


def judge(job: tuple[Path, Row]) -> Row:
    """The row of one recording of the index."""
    folder, entry = job
    slow = slowness()
    words = [str(folder / one) if (folder / one).is_file() else one for one in shlex.split(entry["arguments"])]
    status, found, seconds = identified(folder / entry["file"], words)
    row = {name: entry[name] for name in ("file", "kind", "half", "knowable")}
    row |= {"status": status, "model": found.get("model", ""), "seconds": f"{seconds:.2f}", "slow": f"{slow:.2f}"}
    row["codes"] = " ".join(sorted({one["code"] for one in found.get("warnings", []) + found.get("errors", [])}))
    for name in ("Kc", "Bc"):
        stated = found.get("parameters", {}).get(name, {"ci95": (None, None), "trusted": False})
        low, high = (math.nan if end is None else end for end in stated["ci95"])
        middle, half = ("" if math.isnan(one) else f"{one:.6g}" for one in (0.5 * (low + high), 0.5 * (high - low)))
        row |= {f"{name}_true": entry[name], name: middle, f"{name}_half": half}
        row[f"{name}_trusted"] = str(int(stated["trusted"]))
    return row


def prepare(path: Path) -> None:
    """Compile, in a process that begins, what identification compiles."""
    identified(path)


def fair(rows: list[Row]) -> list[Row]:
    """The rows in an order of which each beginning is spread evenly over the index (golden ratio)."""
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    return [rows[at] for at in sorted(range(len(rows)), key=lambda at: at * golden % 1.0)]


def run(folder: Path, target: Path, wanted: list[Row], processes: int) -> None:
    """Identify the wanted recordings that the target has not, and append a row for each as it comes."""
    done = {row["file"] for row in rows_of(target)} if target.exists() else set()
    jobs = [(folder, row) for row in wanted if row["file"] not in done and (folder / row["file"]).exists()]
    if not jobs:
        return
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    first = min((folder / row["file"] for _, row in jobs), key=lambda path: path.stat().st_size)
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(target.open("a", encoding="utf-8", newline=""))
        if processes == 1:
            prepare(first)
            found = map(judge, jobs)
        else:
            pool = multiprocessing.get_context("spawn").Pool(processes, prepare, (first,))
            found = stack.enter_context(pool).imap_unordered(judge, jobs)
        table = csv.DictWriter(file, FIELDS, lineterminator="\n")
        if not done:
            table.writeheader()
        for number, row in enumerate(found, start=1):
            table.writerow(row)
            file.flush()
            print(f"{number} of {len(jobs)}: {row['file']} {row['status']} {row['seconds']} s", file=sys.stderr)


def rows_of(path: Path) -> list[Row]:
    """The rows of an index or of results, without lines that begin with #."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def error(row: Row, name: str) -> float:
    """The error in half widths of a parameter that is trusted and whose truth is known; otherwise NaN."""
    if row[f"{name}_trusted"] != "1" or not row[f"{name}_true"] or not row[name]:
        return math.nan
    return abs(float(row[name]) - float(row[f"{name}_true"])) / max(float(row[f"{name}_half"]), 1e-300)


def outcome(row: Row) -> str:
    """One of OUTCOMES."""
    misfit = "misfit" in row["codes"].split()
    trusted = [name for name in ("Kc", "Bc") if row[f"{name}_trusted"] == "1"]
    if any(error(row, name) > BEYOND for name in trusted):
        return "off" if misfit else "wrong"
    if not trusted or needless(row):
        return "untrusted"
    return "warned" if misfit else "right"


def needless(row: Row) -> bool:
    """Whether a parameter that the recording identifies is not trusted."""
    return any(row[f"{name}_trusted"] != "1" for name in row["knowable"].split())


def seconds(row: Row) -> float:
    """Processor time on the machine of reference, s."""
    return float(row["seconds"]) / float(row["slow"])


def line(name: str, rows: list[Row]) -> str:
    """A line of the table: counts of the outcomes, of needless distrust, and processor time."""
    found = [outcome(row) for row in rows]
    counts = [found.count(one) for one in OUTCOMES]
    spare = sum(one == "untrusted" and needless(row) for one, row in zip(found, rows, strict=True))
    took = sorted(seconds(row) for row in rows)
    times = (statistics.median(took), took[math.ceil(0.9 * len(took)) - 1], took[-1])
    return " | ".join(["", name, *map(str, (len(rows), *counts, spare)), *(f"{one:.1f}" for one in times), ""]).strip()


def tables(old: list[Row], new: list[Row]) -> Iterator[str]:
    """The table by kind, two lines each, and of all."""
    yield (
        "| kind | recordings | "
        + " | ".join(OUTCOMES)
        + " | of untrusted: needless | median, s | p90, s | longest, s |"
    )
    yield "|" + " --- |" * 11
    for kind in [*dict.fromkeys(row["kind"] for row in sorted(new, key=lambda row: row["file"])), ""]:
        for which, rows in (("old", old), ("new", new)) if old is not new else (("", new),):
            mine = [row for row in rows if kind in ("", row["kind"])]
            yield line(f"{kind or 'all'} {which}".strip(), mine)


def gate(old: list[Row], new: list[Row]) -> Iterator[tuple[bool, str]]:
    """Each condition: whether it is met, and a sentence. The rows are of the same recordings in the same order."""
    before, after = ([outcome(row) for row in rows] for rows in (old, new))
    wrong, were = after.count("wrong"), before.count("wrong")
    yield wrong <= were, f"confidently wrong: {wrong}, old {were}"
    good, was = (sum(one in ("right", "warned") for one in found) for found in (after, before))
    yield good >= was, f"right, with and without a warning: {good}, old {was}"
    bad, were = (sum(bool(row["knowable"]) and refused(row) for row in rows) for rows in (new, old))
    yield bad <= REFUSALS * were, f"misfit or refusal where Kc or Bc can be known: {bad}, old {were}"
    for kind, most in (("", WIDER), (STAND, STAND_WIDER)):
        for name in ("Kc", "Bc"):
            ratio = widening(old, new, name, kind)
            yield not ratio > most, f"half width of {name} over the old, median{kind and ', '}{kind}: {ratio:.2f}"
    for name in ("Kc", "Bc"):
        held = [one <= 1.0 for row in new if name in row["knowable"] and not math.isnan(one := error(row, name))]
        share = statistics.fmean(held) if held else math.nan
        yield HOLDS[0] <= share <= HOLDS[1], f"intervals that hold {name}: {share:.1%} of {len(held)}"
    spent, was = (sum(seconds(row) for row in rows) for rows in (new, old))
    yield spent <= SECONDS * was, f"processor time: {spent:.0f} s, old {was:.0f} s"


def refused(row: Row) -> bool:
    """Whether there is a misfit, or a parameter that can be known is not trusted."""
    return "misfit" in row["codes"].split() or needless(row)


def widening(old: list[Row], new: list[Row], name: str, kind: str) -> float:
    """The median of new over old half width where both are trusted; NaN where there are none."""
    pairs = [(a, b) for a, b in zip(old, new, strict=True) if kind in ("", a["kind"])]
    both = [pair for pair in pairs if all(row[f"{name}_trusted"] == "1" and row[f"{name}_half"] for row in pair)]
    ratios = [float(b[f"{name}_half"]) / float(a[f"{name}_half"]) for a, b in both if float(a[f"{name}_half"])]
    return statistics.median(ratios) if ratios else math.nan


def compared(old: list[Row], new: list[Row]) -> bool:
    """Print the table and the gate over the recordings that both have; return whether it is passed."""
    ours = {row["file"]: row for row in new}
    old = [row for row in old if row["file"] in ours]
    new = [ours[row["file"]] for row in old]
    print("\n".join(tables(old, new)))
    met = True
    for passed, sentence in gate(old, new):
        print(f"{'met   ' if passed else 'FAILED'} {sentence}")
        met &= passed
    return met


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", type=Path, nargs="+", help="the archive, or one or two files of rows")
    parser.add_argument("--write", type=Path, help="file of rows that is written")
    parser.add_argument("--half", choices=("seen", "held"), help="only this half of the archive")
    parser.add_argument("--kinds", nargs="+", help="only kinds that begin so")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--stride", type=int, default=1, help="one in so many recordings")
    options = parser.parse_args()
    files = [options.paths[0] / "index.csv"] if options.write else options.paths
    chosen = [[row for row in rows_of(path) if _wanted(row, options)] for path in files]
    if options.write:
        wanted = fair(chosen[0])
        run(options.paths[0], options.write, wanted[: math.ceil(len(wanted) / options.stride)], options.processes)
    elif len(chosen) == 1:
        print("\n".join(tables(chosen[0], chosen[0])))
    else:
        sys.exit(0 if compared(*chosen) else 1)


def _wanted(row: Row, options: argparse.Namespace) -> bool:
    starts = tuple(options.kinds or ("",))
    return options.half in (None, row["half"]) and row["kind"].startswith(starts)


if __name__ == "__main__":
    main()
