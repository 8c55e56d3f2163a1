"""The results of a long study, one JSON line a recording: a study that was stopped goes on behind the last of them."""

from __future__ import annotations

import contextlib
import hashlib
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
REPORT_EVERY = 5.0  # s between two lines of progress

Row = dict[str, Any]


def usual_place(name: str, *scripts: str) -> Path:
    """The file in the temporary folder: its name carries the fingerprint of hil's code and of these scripts."""
    digest = hashlib.sha256()
    for folder in ("hil", "ga", "drivers", "sim_backend"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    for script in scripts:
        digest.update((Path(__file__).parent / script).read_bytes())
    return Path(tempfile.gettempdir()) / "hil-truth" / f"{name}-{digest.hexdigest()[:10]}.jsonl"


def rows_of(results: Path) -> list[Row]:
    """The results there are; a line that a stopped study left half written is passed over."""
    rows = []
    for line in results.read_text(encoding="utf-8").splitlines() if results.exists() else []:
        with contextlib.suppress(json.JSONDecodeError):
            rows.append(json.loads(line))
    return rows


def append(judge: Callable[[Any], Row], jobs: Sequence[Any], workers: int, results: Path) -> None:
    """Do the jobs in `workers` processes and append each result as it comes."""
    # each process has one thread: two of them with two each would only be in each other's way
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    results.parent.mkdir(parents=True, exist_ok=True)
    with multiprocessing.get_context("spawn").Pool(workers) as pool, results.open("a", encoding="utf-8") as file:
        file.write("\n" if results.stat().st_size else "")  # after a line that was cut short
        for row in _with_progress(pool.imap_unordered(judge, jobs), len(jobs)):
            file.write(json.dumps(row) + "\n")
            file.flush()


def _with_progress(rows: Iterator[Row], count: int) -> Iterator[Row]:
    began = reported = time.monotonic()
    for number, row in enumerate(rows, start=1):
        yield row
        now = time.monotonic()
        if now - reported > REPORT_EVERY or number == count:
            reported = now
            left = (now - began) / number * (count - number)
            print(f"{number} of {count} recordings, {left / 60.0:.1f} min left", file=sys.stderr, flush=True)
