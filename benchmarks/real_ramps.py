"""What `hil identify` says of real ramps of locked actuators: `python benchmarks/real_ramps.py FOLDER`.

FOLDER holds tables (.csv.gz) of the public recordings that results/ramps.csv names, several ramps each. Every ramp is
imported and identified unasked. Nobody knows the true Kc of these actuators: what can be held against the tool is that
consecutive ramps of one actuator get the same model and the same Kc, where they get one, and that what the model leaves
unexplained is small or said. A Kc that is refused is no answer: these are counted. Results go to a file of JSON lines,
so that a study that was stopped goes on; the table goes into results/ramps.csv. Ends with 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import gzip
import io
import itertools
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from page import machine, write_result
from results import append, rows_of

from hil.cli import app as cli

COLUMNS = ("--time", "TIME", "--torque", "TORQUE", "--dtheta", "POSITION")
UNITS = ("--time-unit", "s", "--torque-unit", "N*m", "--dtheta-unit", "rev")
PLAY = 100  # ramps below this number are of 4 N m over 4 s, the others of 25 to 40 N m over 20 s
SAME, RATIO, UNEXPLAINED = 0.8, 1.05, 0.08  # bars: share of files, Kc largest over smallest, share of the torque
HEAD = "| file | ramp | model | Kc, N m/rad | unexplained, % | misfit |\n|" + " --- |" * 6
SUMMARY_HEAD = (
    "| ramps | Kc refused | files with one model | consecutive pairs with one model | largest/smallest Kc | with those "
    "that are refused | unexplained, % |\n|" + " --- |" * 7
)

Row = dict[str, Any]


class Ramp(NamedTuple):
    """One ramp of a file."""

    path: str
    number: int


def ramps(path: Path) -> list[Ramp]:
    """The ramps of a table, in their order."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        numbers = {int(row["test_nr"]) for row in csv.DictReader(file)}
    return [Ramp(str(path), number) for number in sorted(numbers)]


def said(*words: str) -> tuple[int, str]:
    """The status of a command, and its standard output."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO()):
        status = cli.run(list(words))
    return status, output.getvalue()


def judge(ramp: Ramp) -> Row:
    """Import one ramp and identify it."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "one.h5")
        said("import", ramp.path, *COLUMNS, *UNITS, "--where", f"test_nr=={ramp.number}", "-o", path)
        status, text = said("identify", path, "--json", "--workers", "1", "--trials", "1", "--require", "Kc")
    found = json.loads(text) if text else {}
    doubts = [one["code"] for one in (*found.get("warnings", []), *found.get("errors", []))]
    return {
        "file": Path(ramp.path).name.removesuffix(".csv.gz"),
        "number": ramp.number,
        "status": status,
        "model": found.get("model", ""),
        "Kc": found.get("parameters", {}).get("Kc", {}).get("value"),
        "unexplained": found.get("validation", {}).get("nrmse"),
        "codes": sorted(set(doubts)),
        "processor_seconds": time.process_time() - began,
    }


def line(row: Row) -> str:
    """The line of one ramp; a Kc that is refused stands in brackets."""
    kc = "none" if row["Kc"] is None else f"{row['Kc']:.0f}"
    kc = kc if row["status"] == 0 else f"refused ({kc})"
    left = "-" if row["unexplained"] is None else f"{100.0 * row['unexplained']:.1f}"
    flagged = "yes" if "misfit" in row["codes"] else "untested" if "misfit-untested" in row["codes"] else "no"
    return f"| {row['file']} | {row['number']} | {row['model'] or 'none'} | {kc} | {left} | {flagged} |"


def summary(kind: str, found: Sequence[list[Row]]) -> str:
    """The line of the files' ramps of one kind: medians over the files, and counts."""
    every = [row for rows in found for row in rows]
    refused = sum(row["status"] != 0 for row in every)
    alike = sum(len({row["model"] for row in rows}) == 1 for rows in found)
    pairs = [one["model"] == next_one["model"] for rows in found for one, next_one in itertools.pairwise(rows)]
    trusted, whole = ([one for rows in found if not np.isnan(one := of(rows))] for of in (ratio, ratio_of_all))
    apart = [f"{np.median(of):.2f} ({len(of)})" if of else "-" for of in (trusted, whole)]
    left = 100.0 * typical([unexplained(rows) for rows in found])
    cells = [f"{kind} ({len(every)})", refused, f"{alike} of {len(found)}", f"{sum(pairs)} of {len(pairs)}", *apart]
    return "| " + " | ".join(str(cell) for cell in cells) + f" | {left:.1f} |"


def stiffness(rows: Sequence[Row]) -> list[float]:
    """Each Kc, N m/rad, that was not refused."""
    return [row["Kc"] for row in rows if row["status"] == 0]


def ratio(rows: Sequence[Row]) -> float:
    """Largest over smallest Kc; NaN where fewer than two ramps have one."""
    found = stiffness(rows)
    return max(found) / min(found) if len(found) > 1 else float("nan")


def ratio_of_all(rows: Sequence[Row]) -> float:
    """The same, with the values that were refused."""
    return ratio([row | {"status": 0} for row in rows if row["Kc"]])


def unexplained(rows: Sequence[Row]) -> float:
    """The median of what the model leaves of the torque's spread in samples that it was not fitted to."""
    return typical([row["unexplained"] for row in rows if row["unexplained"] is not None])


def typical(values: Sequence[float]) -> float:
    """The median of those that are known; NaN where none is."""
    known = [value for value in values if not np.isnan(value)]
    return float(np.median(known)) if known else float("nan")


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The ramps of each file, the small ones and the large ones apart."""

    def kind(row: Row) -> str:
        return f"{row['file']}, {'play' if row['number'] < PLAY else 'stiffness'}"

    ordered = sorted(rows, key=lambda row: (kind(row), row["number"]))
    return {name: list(mine) for name, mine in itertools.groupby(ordered, key=kind)}


def misses(found: dict[str, list[Row]]) -> list[str]:
    """A sentence for each bar that is missed."""
    same = float(np.mean([len({row["model"] for row in rows}) == 1 for rows in found.values()]))
    ratios = [one for rows in found.values() if not np.isnan(one := ratio(rows))]
    spread = typical(ratios)
    left = typical([unexplained(rows) for rows in found.values()])
    silent = [row for rows in found.values() for row in rows if (row["unexplained"] or 0.0) > UNEXPLAINED]
    silent = [row for row in silent if row["status"] == 0 and "misfit" not in row["codes"]]
    return [
        *([f"the same model in {same:.0%} of the files, not in {SAME:.0%}"] if same < SAME else []),
        *([f"Kc differs {spread:.2f} times (median of {len(ratios)}), more than {RATIO}"] if spread > RATIO else []),
        *([f"{left:.1%} of the torque's spread is unexplained (median), more than 8 %"] if left > UNEXPLAINED else []),
        *([f"ramps with more than 8 % unexplained and no misfit: {len(silent)}"] if silent else []),
    ]


def page(rows: Sequence[Row]) -> str:
    """The tables of results/ramps.csv: both kinds of ramps, the bars that are missed, and every ramp."""
    found = groups(rows)
    kinds = {kind: [mine for name, mine in found.items() if name.endswith(kind)] for kind in ("stiffness", "play")}
    in_order = sorted(rows, key=lambda row: (row["file"], row["number"]))
    return "\n\n".join(
        [
            f"{machine()}. In brackets: the number of ramps, or of files that a median is of.",
            "\n".join([SUMMARY_HEAD, *(summary(kind, files) for kind, files in kinds.items() if files)]),
            "Of both kinds: " + ("; ".join(misses(found)) or "no bar is missed") + ".",
            "\n".join([HEAD, *(line(row) for row in in_order)]),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="hil identify on real ramps of locked actuators")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--results", type=Path, default=Path(tempfile.gettempdir()) / "hil-real-ramps.jsonl")
    options = parser.parse_args()
    done = {(row["file"], row["number"]) for row in rows_of(options.results)}
    wanted = [one for path in sorted(options.folder.glob("*.csv.gz")) for one in ramps(path)]
    wanted = [one for one in wanted if (Path(one.path).name.removesuffix(".csv.gz"), one.number) not in done]
    append(judge, wanted, options.workers, options.results)
    rows = rows_of(options.results)
    text, broken = page(rows), misses(groups(rows))
    write_result("ramps", text)
    print(text)
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()
