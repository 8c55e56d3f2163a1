"""Recordings that do not fit in memory: what is held of them does not grow with their length."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from hil.signals.prepare import Signals

ROOT = Path(__file__).parents[3]

MEASURED = """
import resource, sys
from pathlib import Path
import numpy as np
from ga.lad.out_of_core import reduce
from hil.uncertainty.confidence import spread
from hil.identification.disk_table import Spool

ROWS, BLOCK = 4_000_000, 1 << 18

def block(rng, rows):
    columns = rng.standard_normal((rows, 2))
    return columns, columns @ [1.0, 2.0] + 0.1 * rng.standard_normal(rows)

def gone_through(rows):
    rng = np.random.default_rng(0)
    with Spool(Path(sys.argv[1]) / "beside", rows, 2) as spool:
        for start in range(0, rows, BLOCK):
            spool.extend(*block(rng, min(BLOCK, rows - start)))
        spread(spool.blocks, reduce(spool.blocks, rows).optimum.genes)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

before = gone_through(ROWS // 8)  # with all that is loaded and compiled
print(gone_through(ROWS) - before, ROWS * 3 * 8)
"""


def test_thinned_signals_hold_nothing_of_the_ones_they_were_taken_from() -> None:
    many = np.arange(1000.0)
    signals = Signals(many, many, many, many, many, many, (0,), 0, 0, 0, False, (0.1, 5.0), 0.0, None, "given")
    few = signals.thinned(100)
    assert few.time.tolist() == many[::100].tolist()
    assert few.time.base is None
    assert few.dtheta_dot.base is None


def test_going_through_a_spool_holds_a_fraction_of_it(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", MEASURED, str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    growth, table = map(int, ended.stdout.split())
    assert growth < 0.4 * table
