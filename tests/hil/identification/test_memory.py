"""Recordings that do not fit in memory: what is held of them does not grow with their length."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

MEASURED = """
import resource, sys
from pathlib import Path
import numpy as np
from ga.lad.out_of_core import reduce
from hil.identification.fitting.confidence import confidence_intervals
from hil.identification.fitting.disk_table import DiskTable

ROWS, BLOCK = 2_000_000, 1 << 17

def block(rng, rows):
    columns = rng.standard_normal((rows, 2))
    return columns, columns @ [1.0, 2.0] + 0.1 * rng.standard_normal(rows)

def gone_through(rows):
    rng = np.random.default_rng(0)
    with DiskTable(Path(sys.argv[1]) / "beside", rows, 2) as table:
        for start in range(0, rows, BLOCK):
            table.extend(*block(rng, min(BLOCK, rows - start)))
        confidence_intervals(table.blocks, reduce(table.blocks, rows).optimum.genes)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

before = gone_through(ROWS // 8)  # with all that is loaded and compiled
print(gone_through(ROWS) - before, ROWS * 3 * 8)
"""


@pytest.mark.study
def test_reading_a_table_on_disk_holds_a_fraction_of_it_in_memory(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", MEASURED, str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    growth, table = map(int, ended.stdout.split())
    assert growth < 0.4 * table
