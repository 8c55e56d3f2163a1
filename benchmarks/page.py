"""Where the benchmarks write: rows under results/, and the machine they ran on."""

from __future__ import annotations

import csv
import io
import os
import platform
import re
import subprocess
from datetime import UTC, datetime
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"
RESULTS = Path(__file__).parent / "results"


def machine() -> str:
    """The processor, the number of cores, how busy they were, the versions and the date."""
    import numba
    import numpy as np

    name = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        found = re.search(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
        name = found.group(1) if found else name
    return (
        f"{name}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; {platform.system()}, "
        f"Python {platform.python_version()}, NumPy {np.__version__}, numba {numba.__version__}; "
        f"{datetime.now(UTC):%Y-%m-%d}; revision {revision()}"
    )


def revision() -> str:
    """The commit of the code that ran, with "+" where files differ from it; "unknown" outside a git repository."""
    command = ["git", "-C", str(DOCS.parent), "describe", "--always", "--exclude=*", "--dirty=+"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def write_result(name: str, text: str) -> None:
    """Write the Markdown tables of a study as results/NAME.csv, an empty line between two tables.

    Lines that are no table rows become comments, each above the table that follows it.
    """
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    for block in re.findall(r"(?:^\|.*\n?)+|(?:^[^|\n].*\n?)+", text, flags=re.MULTILINE):
        if not block.startswith("|"):
            out.writelines(f"# {line.lstrip('#* ')}\n" for line in block.splitlines())
            continue
        cells = ([_plain(cell) for cell in line.strip()[1:-1].split("|")] for line in block.splitlines())
        rows.writerows(row for row in cells if "".join(row).strip("-:"))
        out.write("\n")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.csv").write_text(out.getvalue(), encoding="utf-8")


def _plain(cell: str) -> str:
    """Return the cell without Markdown, a whole number without its commas."""
    text = cell.strip().replace("`", "").replace("**", "")
    return text.replace(",", "") if text.replace(",", "").isdigit() else text
