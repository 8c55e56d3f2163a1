"""Join two files of one run whose clocks differ, and count how often Kc and Bc lie beside their 95 % intervals.

python benchmarks/joined.py --draws 60 [--kinds joined] [--processes 2]

The simulated stand is recorded at 1 kHz. The drive's log has its deflection at 250 Hz, the cell's its torque at 200 Hz,
each at random ticks of the simulator (jitter) and without 2 % of the rows; the cell's clock is up to 1 s off. `joined`:
hil finds the shift. `shared`: the same files on one clock. `one file`: the same rows of the drive's log with the torque
of their own ticks. Prints a line a kind; ends with status 1 where more than 5 % of the joined draws are beside.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hil.api.analysis import identify
from hil.api.runs import record
from hil.errors import Untrustworthy, WrongUse
from hil.exchange.importer import Column, import_table
from hil.exchange.join import Join
from hil.recording.reader import Recording

RATE, SECONDS, LOST, MOST = 1000.0, 5.0, 0.02, 0.05
KINDS = ("one file", "shared", "joined")
DRIVE, CELL = 4, 5  # ticks of the simulator for a row


def draw(seed: int, kinds: Sequence[str] = KINDS) -> list[dict[str, Any]]:
    """Return a row for each kind: the shift and its error in ms, and Kc and Bc with their intervals and truths."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        record("sim", profile="multisine", duration=SECONDS, rate=RATE, seed=seed, output=place / "all.h5")
        with Recording(place / "all.h5") as made:
            truth, time = made.truth(), made.channel("time")
            torque, angle = made.channel("torque"), made.channel("dtheta")
        late = rng.uniform(-1.0, 1.0)
        rows = {every: _rows(rng, len(time), every) for every in (DRIVE, CELL)}
        _write(place / "drive.csv", time[rows[DRIVE]], angle[rows[DRIVE]], "t [s],angle [rad]", torque[rows[DRIVE]])
        _write(place / "cell.csv", time[rows[CELL]] - late, torque[rows[CELL]], "t [s],tau [N*m]")
        _write(place / "same.csv", time[rows[CELL]], torque[rows[CELL]], "t [s],tau [N*m]")
        joins = (None, Join(place / "same.csv", shared=True), Join(place / "cell.csv"))
        return [
            _found(place, kind, join, truth) | {"seed": seed, "late": late}
            for kind, join in zip(KINDS, joins, strict=True)
            if kind in kinds
        ]


def _rows(rng: np.random.Generator, count: int, every: int) -> Any:
    starts = np.arange(0, count - every, every)
    return (starts + rng.integers(0, every, len(starts)))[rng.random(len(starts)) >= LOST]


def _write(path: Path, time: Any, values: Any, heading: str, *more: Any) -> None:
    heading += ",own [N*m]" * len(more)
    np.savetxt(path, np.column_stack([time, values, *more]), "%.12g", ",", header=heading, comments="")


def _found(place: Path, kind: str, join: Join | None, truth: dict[str, float]) -> dict[str, Any]:
    torque = "own" if join is None else "tau"
    columns = {"time": Column("t"), "torque": Column(torque), "dtheta": Column("angle")}
    row: dict[str, Any] = {"kind": kind, "refused": ""}
    try:
        row["said"] = import_table(place / "drive.csv", place / "a.h5", columns, [], join=join, force=True).said
        result = identify(place / "a.h5").as_json()
    except (WrongUse, Untrustworthy) as refused:
        return row | {"refused": str(refused)}
    for name in ("Kc", "Bc"):
        found = result["parameters"][name]
        row |= {name: found["value"], f"{name} low": found["ci95"][0], f"{name} high": found["ci95"][1]}
        row |= {f"{name} true": truth[name], f"{name} trusted": found["trusted"]}
    return row


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--rows", type=Path, help="a file to which each draw is appended, a JSON line a kind")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(options.processes) as pool:
        for found in pool.map(partial(draw, kinds=options.kinds), range(options.draws)):
            rows += found
            if options.rows is not None:
                with options.rows.open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(row) + "\n" for row in found)
    print("files,draws,refused,untrusted,Kc beside,Bc beside,Kc error,Bc error,Bc half width")
    shares = {kind: _line(kind, [row for row in rows if row["kind"] == kind]) for kind in options.kinds}
    return int(max(shares.get("joined", (0.0, 0.0))) > MOST)


def _line(kind: str, rows: list[dict[str, Any]]) -> tuple[float, float]:
    read = [row for row in rows if not row["refused"]]
    beside = [
        float(np.mean([not row[f"{one} low"] <= row[f"{one} true"] <= row[f"{one} high"] for row in read]))
        for one in ("Kc", "Bc")
    ]
    errors = [float(np.median([abs(row[one] / row[f"{one} true"] - 1.0) for row in read])) for one in ("Kc", "Bc")]
    half = float(np.median([0.5 * (row["Bc high"] - row["Bc low"]) / row["Bc true"] for row in read]))
    untrusted = sum(not (row["Kc trusted"] and row["Bc trusted"]) for row in read)
    words = (
        kind,
        len(rows),
        len(rows) - len(read),
        untrusted,
        *(f"{100 * one:.3g} %" for one in (*beside, *errors, half)),
    )
    print(*words, sep=",")
    return beside[0], beside[1]


if __name__ == "__main__":
    sys.exit(main())
