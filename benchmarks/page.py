"""Where the benchmarks write: one section each of a page of docs/, and the machine that it was measured on."""

from __future__ import annotations

import os
import platform
import re
from datetime import UTC, datetime
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"


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
        f"{datetime.now(UTC):%Y-%m-%d}"
    )


def write_section(name: str, text: str, file: str = "performance.md") -> None:
    """Put the text between the section's marks, at the end of the page where it has none yet."""
    path = DOCS / file
    page = path.read_text(encoding="utf-8") if path.exists() else f"# {path.stem.capitalize()}\n"
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    section = f"{begin}\n{text.strip()}\n\n{end}\n"
    if begin in page:
        before, rest = page.split(begin)
        page = before + section + rest.split(f"{end}\n", 1)[1]
    else:
        page = f"{page.rstrip()}\n\n{section}"
    path.write_text(page, encoding="utf-8")
