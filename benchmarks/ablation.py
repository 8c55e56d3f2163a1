"""What each mechanism of the identification buys: the archive without it, one mechanism at a time.

    python benchmarks/ablation.py FOLDER --rows ROWS [--stride 10] [--only TEXT] [--processes 2]

FOLDER is an archive (`archive.py`), ROWS a folder of rows, one file for each mechanism; rows that are there are not
made again. Prints a line for each mechanism, and writes results/ablation.csv. `base` is the program as it is. Columns:
on how many recordings Kc, Bc, an interval or the trust differs from `base`; the outcomes as `replay.py` defines them;
how many trusted intervals hold; the median of new over old half width; processor time over that of `base`. A term's
line is the program without it. Whoever adds a mechanism adds a line to SWITCHES, and shows its row.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import importlib
import multiprocessing
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import replay

from hil.identification.misfit import regressors

RESULTS = Path(__file__).parent / "results" / "ablation.csv"
HEAD = ("without", "recordings", "differ", *replay.OUTCOMES, "needless", "hold", "of", "Kc_width", "Bc_width", "time")
BASE = "base"
ALIKE = 1e-6  # relative difference of a value or a half width, from which a recording counts as one that differs

Switch = tuple[str, Callable[..., Any]]
"""Where a function is used, as module:name, and what takes its place."""


def _nothing(*_: object, **__: object) -> None:
    return None


def _none(*_: object, **__: object) -> list[object]:
    return []


def _zeros(part: Any, *_: object) -> Any:
    return np.zeros(len(part.half_width))


def _first(first: Any, *_: object, **__: object) -> Any:
    return first


def _without_place(found: Any) -> Any:
    """Return regressors or cuts without those by angle, amplitude and direction."""
    left_out = {"angle", "amplitude", "direction"}
    if isinstance(found, dict):
        return {code: columns for code, columns in found.items() if code not in left_out}
    return [one for one in found if one[0] not in left_out]


def _second(_: object, second: Any, *__: object, **___: object) -> Any:
    return second


_IDENTIFY, _AVERAGE = "hil.identification.identify", "hil.identification.mixture.average"
_LACK_OF_FIT = "hil.identification.misfit.lack_of_fit"
_DEFLECTION = "hil.identification.deflection.correction"
SWITCHES: dict[str, tuple[Switch, ...]] = {
    BASE: (),
    "averages over models": ((f"{_IDENTIFY}:averaged", lambda *_: {}),),
    "effects that the noise hides": ((f"{_AVERAGE}:hidden", _none),),
    "refused models with weak evidence against them": ((f"{_AVERAGE}:_rivals", _none),),
    "odds of a late torque": ((f"{_AVERAGE}:_late", lambda largest, _: [(largest, 0.0)]),),
    "a branch behind a delay": ((f"{_AVERAGE}:_hidden", lambda *_: 0.0),),
    "errors of the deflection": ((f"{_IDENTIFY}:read_with_errors", _nothing),),
    "the command as an instrument": ((f"{_DEFLECTION}:by_command", _nothing),),
    "rounding at rest": ((f"{_DEFLECTION}:rounded_at_rest", _zeros),),
    "compass in the search": (("hil.identification.candidates.fits:compass_search", _second),),
    "exchange of terms": (("hil.identification.candidates.selection:Beside.better", _second),),
    "exchange that adds terms": (("hil.identification.candidates.selection:Beside._larger", _none),),
    "rare terms": (("hil.identification.candidates.choice:_describes", lambda *_: True),),
    "rare terms only if asked for": (("hil.identification.candidates.choice:_describes", lambda *_: False),),
    "test of the residuals": ((f"{_IDENTIFY}:tested", _nothing),),
    "tests by angle, amplitude and direction": (
        (f"{_LACK_OF_FIT}:cuts", lambda *given: _without_place(regressors.cuts(*given))),
        (f"{_LACK_OF_FIT}:regressors", lambda *given: _without_place(regressors.regressors(*given))),
    ),
    "a misfit widens": ((f"{_IDENTIFY}:with_misfit", _first),),
    "span of a spring that stiffens": ((f"{_IDENTIFY}:span_met", _nothing),),
    "smooth part of a held torque": (("hil.signals.defects:smooth_torque", _first),),
    "what held set-points take off Bc": ((f"{_IDENTIFY}:most_taken_off", lambda *_: 0.0),),
    "steps of a zero": (("hil.signals.prepare:zero_steps", _none),),
    "wrong torque readings": (("hil.signals.defects:outliers", lambda time, *_: np.zeros(len(time), dtype=bool)),),
}


def switches() -> dict[str, tuple[Switch, ...]]:
    """SWITCHES, and one for each term that model selection may choose."""
    from ga.model.terms import SMALLEST, TERMS

    terms = [name for name, one in TERMS.items() if one.selection != "named" and name not in SMALLEST.split("+")]
    return SWITCHES | {f"term {name}": (_without(name),) for name in terms}


def _without(term: str) -> Switch:
    from hil.identification.candidates import selection

    chosen = selection.select

    def select(signals: object, seen: object, terms: tuple[str, ...]) -> object:
        return chosen(signals, seen, tuple(one for one in terms if one != term))  # type: ignore[arg-type]

    return "hil.identification.candidates.selection:select", select


@contextlib.contextmanager
def switched_off(name: str) -> Iterator[None]:
    """The program without one mechanism. Raises AttributeError if its function is not where SWITCHES says."""
    with contextlib.ExitStack() as stack:
        for place, replacement in switches()[name]:
            module, attribute = place.split(":")
            *of, attribute = attribute.split(".")
            owner: object = importlib.import_module(module)
            for inner in of:
                owner = getattr(owner, inner)
            stack.enter_context(patch.object(owner, attribute, replacement))
        yield


def judged(name: str, job: tuple[Path, replay.Row]) -> replay.Row:
    """The row of one recording without one mechanism."""
    with switched_off(name):
        return replay.judge(job)


def run(folder: Path, rows: Path, name: str, wanted: list[replay.Row], processes: int) -> list[replay.Row]:
    """The rows of a mechanism for the wanted recordings, as they are or made now."""
    target = rows / f"{name.replace(' ', '-')}.csv"
    done = {row["file"]: row for row in replay.rows_of(target)} if target.exists() else {}
    jobs = [(folder, row) for row in wanted if row["file"] not in done and (folder / row["file"]).exists()]
    if jobs:
        with target.open("a", encoding="utf-8", newline="") as file, _map(processes) as mapped:
            table = csv.DictWriter(file, replay.FIELDS, lineterminator="\n")
            if not done:
                table.writeheader()
            for row in mapped(partial(judged, name), jobs):
                table.writerow(row)
                file.flush()
                done[row["file"]] = row
    return [done[row["file"]] for row in wanted if row["file"] in done]


@contextlib.contextmanager
def _map(processes: int) -> Iterator[Callable[..., Iterator[replay.Row]]]:
    if processes == 1:
        yield map
        return
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield pool.imap_unordered


def compared(name: str, base: list[replay.Row], rows: list[replay.Row]) -> dict[str, object]:
    """A line of the table."""
    before = {row["file"]: row for row in base}
    pairs = [(before[row["file"]], row) for row in rows]
    outcomes = [replay.outcome(row) for row in rows]
    errors = [replay.error(row, of) for row in rows for of in ("Kc", "Bc") if of in row["knowable"].split()]
    known = [one for one in errors if not np.isnan(one)]
    took = sum(map(replay.seconds, rows)) / sum(replay.seconds(old) for old, _ in pairs)
    return {
        "without": name,
        "recordings": len(rows),
        "differ": sum(differs(*pair) for pair in pairs),
        **{one: outcomes.count(one) for one in replay.OUTCOMES},
        "needless": sum(map(replay.needless, rows)),
        "hold": sum(one <= 1.0 for one in known),
        "of": len(known),
        **{f"{of}_width": f"{_widening(pairs, of):.2f}" for of in ("Kc", "Bc")},
        "time": f"{took:.2f}",
    }


def differs(old: replay.Row, new: replay.Row) -> bool:
    """Whether a result differs in its status, in trust, or in a value or half width by more than ALIKE."""
    if any(old[of] != new[of] for of in ("status", "codes", "Kc_trusted", "Bc_trusted")):
        return True
    numbers = [(float(old[of] or "nan"), float(new[of] or "nan")) for of in ("Kc", "Bc", "Kc_half", "Bc_half")]
    return any(abs(a - b) > ALIKE * max(abs(a), abs(b)) for a, b in numbers)


def _widening(pairs: list[tuple[replay.Row, replay.Row]], of: str) -> float:
    return replay.widening([old for old, _ in pairs], [new for _, new in pairs], of, "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the archive")
    parser.add_argument("--rows", type=Path, required=True, help="folder of the rows")
    parser.add_argument("--only", default="", help="only mechanisms with this text in their name")
    parser.add_argument("--kinds", nargs="+", default=[""], help="only kinds of recordings that begin so")
    parser.add_argument("--stride", type=int, default=1, help="one in so many recordings")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args()
    options.rows.mkdir(parents=True, exist_ok=True)
    every = replay.fair(replay.rows_of(options.folder / "index.csv"))
    every = [row for row in every if row["kind"].startswith(tuple(options.kinds))]
    wanted = every[: -(-len(every) // options.stride)]
    base = run(options.folder, options.rows, BASE, wanted, options.processes)
    with options.results.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, HEAD, lineterminator="\n")
        table.writeheader()
        for name in switches():
            if options.only in name:
                row = compared(name, base, run(options.folder, options.rows, name, wanted, options.processes))
                table.writerow(row)
                print(" | ".join(str(one) for one in row.values()), flush=True)


if __name__ == "__main__":
    main()
