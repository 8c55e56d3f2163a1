"""Write a report as one HTML file that needs no other file and no network."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ga.collector import uncollected
from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.recording.output import atomic_write
from hil.report.chart import Chart, library

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

_INK = "#010203"  # stands for the colour of the page's text, which is another in the dark
_INLINE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: it can be searched, and takes the page's colour
    "svg.hashsalt": "hil",
    "font.size": 11,
    "grid.color": "#808080",  # between the colours of the papers, light and dark
    "grid.alpha": 0.6,
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), _INK),
    **dict.fromkeys(("figure.facecolor", "axes.facecolor", "legend.facecolor"), "none"),
}


@dataclass(frozen=True, slots=True)
class Section:
    """A section of a page: a heading, a table and lines of text below it. rows: of the table; the first row has the
    headings.
    """

    heading: str
    rows: Sequence[Sequence[str]] = ()
    lines: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure in a page.

    alt: a sentence with the figure's numbers, for readers who cannot see the figure. draw: function that returns the
    figure. chart: shown instead of the figure on a screen, if the page's script runs.
    """

    name: str
    heading: str
    alt: str
    draw: Callable[[], Figure]
    chart: Chart | None = None


@dataclass(frozen=True, slots=True)
class Page:
    """The content of a page.

    title: name of the recording, and result. verdict: lines with the answer. failed: whether there is no result.
    sections: the first is above the pictures, the others are below. provenance: pairs of a name and a text. table: the
    command's JSON object.
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
    with uncollected():
        drawn = [(one, Markup(svg(one))) for one in page.pictures]  # noqa: S704 - ours, which escapes its texts
    embedded = Markup(_embedded(page.table))  # noqa: S704 - escaped for a script element
    charts = {one.name: Markup(one.chart.as_json()) for one in page.pictures if one.chart}  # noqa: S704 - escaped too
    parts = {name: Markup(part) for name, part in library().items()} if charts else {}  # noqa: S704 - of this package
    text = template.from_string(source).render(page=page, pictures=drawn, json=embedded, charts=charts, library=parts)
    with atomic_write(path, force=force) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def svg(picture: Picture) -> str:
    """Return a picture as an SVG element for a page with several pictures, in the colours of the page."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.StringIO()
    with rc_context(_INLINE):
        # savefig would draw it twice, once for the layout alone
        FigureCanvasSVG(picture.draw()).print_svg(buffer)  # type: ignore[no-untyped-call]
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r' (?:width|height)="[\d.]+pt"', "", text, count=2)
    # a tenth of a point is finer than a screen, and half as long to write
    text = re.sub(r' d="[^"]+"', lambda path: re.sub(r"(\.\d)\d+", r"\1", path[0]), text)
    text = re.sub(r' id="image\w+"', "", text)  # the scales of two panels are the same image, and nothing refers to it
    for mark in (' id="', "url(#", 'href="#'):  # names are unique in a page, not only in a picture
        text = text.replace(mark, f"{mark}{picture.name}-")
    return text.replace(_INK, "currentColor")


def table_rows(table: Table) -> list[list[str]]:
    """Return a table for the terminal as rows of texts; the first row has the headings."""
    columns = [[str(column.header), *(str(cell) for cell in column.cells)] for column in table.columns]
    return [list(row) for row in zip(*columns, strict=True)]


def _embedded(table: Mapping[str, Any]) -> str:
    """Return JSON in which no text can end the script element that contains the JSON."""
    text = json.dumps(table, indent=1, allow_nan=False, default=str)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
