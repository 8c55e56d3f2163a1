"""Write a report as one HTML file that needs no other file and no network."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.printable import printable
from hil.recording.output import atomic_write
from hil.report.chart import Chart, library
from hil.report.formatting import Section


@dataclass(frozen=True, slots=True)
class Picture:
    """A chart in a page.

    alt: a sentence with the chart's numbers, for readers who cannot see it. chart: function that returns the chart.
    """

    name: str
    heading: str
    alt: str
    chart: Callable[[], Chart]


@dataclass(frozen=True, slots=True)
class Page:
    """The content of a page.

    title: name of the recording, and result. verdict: lines with the answer. failed: whether there is no result.
    provenance: pairs of a name and a text. table: the command's JSON object. on_first_page, unfolded: numbers of
    pictures and of sections that are shown at once, these sections above the pictures; the others are folded. A section
    with the heading of a picture stands below that picture.
    """

    title: str
    subject: str
    verdict: Sequence[str]
    diagnostics: Sequence[Diagnostic]
    sections: Sequence[Section]
    pictures: Sequence[Picture]
    provenance: Sequence[tuple[str, str]]
    table: Mapping[str, Any]
    failed: bool = False
    on_first_page: int = 2
    unfolded: int = 1

    @property
    def state(self) -> str:
        """Return "error", "warning" or "good", for the most serious diagnostic of the page."""
        if self.failed or any(one.is_error for one in self.diagnostics):
            return "error"
        return "warning" if self.diagnostics else "good"


def check_page_name(path: Path) -> Path:
    """Return `path` as the path of a page. Raises WrongUse if its suffix is that of another format."""
    if path.suffix.lower() not in {".html", ".htm"}:
        raise WrongUse(f"{path} is no name of a report, which is HTML: name it {path.with_suffix('.html')}")
    return path


def write(page: Page, path: Path, *, force: bool) -> Path:
    """Write a page to `path` and return the path. force: replace an existing file. Raises WrongUse."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    check_page_name(path)
    source = resources.files("hil.report").joinpath("page.html.j2").read_text(encoding="utf-8")
    template = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    embedded = Markup(_embedded(page.table))  # noqa: S704 - escaped for a script element
    charts = [(one, Markup(one.chart().as_json())) for one in page.pictures]  # noqa: S704 - escaped too
    parts = {name: Markup(part) for name, part in library().items()} if charts else {}  # noqa: S704 - of this package
    text = template.from_string(source).render(page=page, pictures=charts, json=embedded, library=parts)
    with atomic_write(path, force=force) as temporary:
        temporary.write_text(printable(text), encoding="utf-8")
    return path


def table_lines(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of texts as lines, each column as wide as its longest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return [line.rstrip() for line in lines]


def _embedded(table: Mapping[str, Any]) -> str:
    """Return JSON in which no text can end the script element that contains the JSON."""
    text = json.dumps(table, indent=1, allow_nan=False, default=str)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
