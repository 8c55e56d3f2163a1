"""The report: one file that stands alone, whose numbers are those of the JSON and whose texts cannot become markup."""

from __future__ import annotations

import base64
import gc
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure

import hil as api
from hil.cli.app import run
from hil.identification.result import Identification
from hil.recording.channels import Row
from hil.recording.writer import Header, RecordingWriter
from hil.report.chart import Chart, Line, Panel
from hil.report.html_page import Page, Picture, Section, write
from hil.report.pictures.canvas import canvas
from hil.report.pictures.files import write_pictures

from ..conftest import Hil, Maker
from .conftest import recording


class Elements(HTMLParser):
    """The elements of a page in order, and its texts by element."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if data.strip() and self.found:
            self.texts.append((self.found[-1][0], data))

    def text(self, tag: str) -> str:
        return " ".join(text for at, text in self.texts if at == tag)

    def attributes(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]


Report = tuple[api.IdentificationResult, str]


@pytest.fixture(scope="module")
def report(answer: api.IdentificationResult, tmp_path_factory: pytest.TempPathFactory) -> Report:
    path = tmp_path_factory.mktemp("report") / "r.html"
    return answer, answer.report(path, "hil identify a.h5").read_text(encoding="utf-8")


def embedded(page: str) -> dict[str, Any]:
    (text,) = re.findall(r'<script type="application/json" id="result">(.+?)</script>', page, re.DOTALL)
    found: dict[str, Any] = json.loads(text)
    return found


def test_nothing_from_a_file_becomes_markup(
    tmp_path: Path, found: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.report.html_page.svg", lambda _: "<svg/>")  # drawing takes longer than all the rest
    evil = '</script><script>alert("1")</script>&amp;$x$'
    named = api.IdentificationResult(replace(found, recordings=(tmp_path / "a<b>&'$x$.h5",)))
    plain = Elements(named.report(tmp_path / "r.html").read_text(encoding="utf-8"))
    assert plain.text("title").startswith("a<b>&'$x$.h5: ")
    page = Page(
        evil, evil, [evil], [], [Section(evil, [["", evil], [evil, evil]], [evil])], [], [(evil, evil)], {evil: evil}
    )
    text = write(page, tmp_path / "evil.html", force=False).read_text(encoding="utf-8")
    assert len(Elements(text).attributes("script")) == 1
    assert embedded(text) == {evil: evil}


def test_a_report_holds_the_json_object_and_says_its_numbers_first(report: Report) -> None:
    result, page = report
    assert embedded(page) == json.loads(json.dumps(result.as_json()))
    elements = Elements(page)
    assert elements.text("title") == f"a.h5: {result}"
    for verdict in str(result).removesuffix("  (95 %)").split(",  "):
        assert page.index(verdict, page.index("<body>")) < page.index("<table", page.index("<body>"))
    assert result.identification.recordings[0].name in elements.text("h1")
    assert "hil identify a.h5" in page[page.index("Provenance") :]


def test_a_report_needs_no_network_and_no_other_file(report: Report) -> None:
    page = report[1]
    addresses = set(re.findall(r"https?://[^\s\"'<>)]+", page))
    named = ("http://www.w3.org/", "https://github.com/leeoniya/uPlot")  # a name space, and a library in its comment
    assert {address for address in addresses if not address.startswith(named)} == set()
    for tag, attributes in Elements(page).found:
        assert tag not in {"link", "iframe", "object", "img"}
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:image/png;base64,"))


def test_every_picture_has_a_sentence_with_its_numbers(report: Report) -> None:
    elements = Elements(report[1])
    pictures = [found for found in elements.attributes("div") if found.get("role") == "img"]
    assert len(pictures) == len(elements.attributes("figure")) >= 5
    for picture in pictures:
        assert re.search(r"\d", picture["aria-label"] or "")
    names = [found["id"] for tag, found in elements.found if "id" in found]
    assert len(names) == len(set(names))


def test_a_report_suits_a_phone_the_dark_and_paper(report: Report) -> None:
    page = report[1]
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in Elements(page).attributes("meta")
    assert "@media (prefers-color-scheme: dark)" in page
    assert "@media print" in page
    assert "currentColor" in page
    assert "#010203" not in page


def test_a_chart_holds_its_values_within_a_screens_resolution_and_where_a_line_is_interrupted() -> None:
    x = np.array([3.0, 0.0, 1.0, 2.0, np.nan])
    values = np.array([5.0, -1.0, np.nan, 0.25, 7.0])
    table = json.loads(Chart("t [s]", x, [Panel("y", [Line("</script>", values, "soft")])]).as_json())

    def read(packed: dict[str, Any]) -> list[float]:
        counts = np.frombuffer(base64.b64decode(packed["data"]), "<u2")
        return [float("nan") if one == 65_535 else packed["low"] + packed["step"] * one for one in counts.tolist()]

    np.testing.assert_allclose(read(table["x"]), [0.0, 1.0, 2.0, 3.0], atol=1e-4)
    np.testing.assert_allclose(read(table["panels"][0]["lines"][0]), [-1.0, np.nan, 0.25, 5.0], atol=1e-4)


def test_a_failed_identification_has_a_report_with_the_failure_first(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(samples=8)
    ended = hil("identify", path, "--report", "r.html", "--json")
    assert ended.status == 1
    page = Path("r.html").read_text(encoding="utf-8")
    assert embedded(page) == ended.json
    reason = ended.json["errors"][0]["message"]
    elements = Elements(page)
    assert reason in " ".join(text for _, text in elements.texts)
    assert elements.text("title") == "a.h5: no result"
    assert len(elements.attributes("figure")) == 1
    assert "wrote r.html" in ended.err


def test_a_recording_without_a_row_has_a_report_too(hil: Hil, tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"kind": "chirp"}), 10) as part:
        part.append(Row(0, time=0.0))
        part.finish("test")
    assert hil("identify", "a.h5", "--report", "r.html").status == 1
    assert "Nothing could be identified" in Path("r.html").read_text(encoding="utf-8")


def test_the_pictures_are_written_into_a_folder_and_one_that_is_there_is_kept(
    hil: Hil, make_recording: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: dict[str, bool] = {}
    monkeypatch.setattr(
        "hil.report.pictures.files.save_picture", lambda _, path, *, force: written.update({path.name: force})
    )
    words = ("identify", make_recording(samples=400, noise=2e-4), "--model", "linear", "--trials", 1, "--plot", "p")
    Path("p").mkdir()
    Path("p/traces.png").write_text("the old one")
    ended = hil(*words)
    assert (ended.status, "traces.png exists" in ended.err, written) == (2, True, {})
    assert hil(*words, "--force").status == 0
    assert {"traces.png", "loop.png", "residuals.png", "intervals.png"} <= set(written)
    assert all(written.values())


def test_a_picture_is_a_png(tmp_path: Path) -> None:
    picture = Picture("p", "Picture", "A panel.", lambda: canvas(1, 1, (4, 3))[0])
    (path,) = write_pictures([picture], tmp_path / "new", force=False)
    assert path.name == "p.png"
    assert path.read_bytes().startswith(b"\x89PNG")


def test_inspect_draws_the_recording_and_refuses_another_format(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(samples=400, noise=2e-4)
    assert hil("inspect", path, "--plot", "a.png").status == 0
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    assert hil("inspect", path, "--plot", "a.png").status == 2
    ended = hil("inspect", path, "--plot", "a.svg")
    assert (ended.status, "a.svg is no name of a picture" in ended.err) == (2, True)


@pytest.mark.study
def test_the_size_of_a_report_does_not_grow_with_the_samples(report: Report, tmp_path: Path) -> None:
    """2000 samples, and 20,000."""
    many = api.identify(recording(tmp_path / "many.h5", samples=20_000), "linear", trials=1)
    size = many.report(tmp_path / "many.html").stat().st_size
    assert size < 1_500_000
    assert size < 1.4 * len(report[1].encode())


@pytest.fixture
def opened(tmp_path: Path) -> Callable[[Path, str], subprocess.CompletedProcess[str]]:
    """Open a page in a real browser with more scripts at its end; its elements then are on the standard output."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("REPORT NOT OPENED IN A BROWSER: there is no chromium; apt-get install chromium")
    words = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]

    def run_browser(page: Path, scripts: str) -> subprocess.CompletedProcess[str]:
        copy = tmp_path / "opened.html"
        copy.write_text(page.read_text(encoding="utf-8").replace("</body>", f"{scripts}</body>"), encoding="utf-8")
        return subprocess.run(
            [browser, *words, "--enable-logging=stderr", "--virtual-time-budget=20000", "--dump-dom", copy.as_uri()],
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
        )

    return run_browser


Opened = Callable[[Path, str], subprocess.CompletedProcess[str]]


def range_shown(dom: str) -> tuple[float, float]:
    (low, high) = re.findall(r'class="range" role="status">time \[s\]: (\S+) to (\S+)</span>', dom)[0]
    return float(low), float(high)


@pytest.mark.study
def test_a_browser_opens_the_report_from_disk_shows_the_numbers_and_zooms(
    opened: Opened, report: Report, tmp_path: Path
) -> None:
    result, page = report[0], tmp_path / "r.html"
    page.write_text(report[1], encoding="utf-8")
    closer = "<script>document.querySelector('[data-chart=traces] button[value=closer]').click()</script>"
    whole, near = opened(page, ""), opened(page, closer)
    assert "Kc = " in whole.stdout
    assert embedded(whole.stdout) == json.loads(json.dumps(result.as_json()))
    first, last = range_shown(whole.stdout)
    low, high = range_shown(near.stdout)
    assert high - low == pytest.approx((last - first) / 2.0, rel=0.01)
    assert low == pytest.approx(first + (last - first) / 4.0, rel=0.01)
    for shown in (whole, near):
        assert shown.stdout.count("<canvas") == 2
        assert "CONSOLE" not in shown.stderr  # neither errors of scripts nor resources that are missing


@pytest.mark.study
@pytest.mark.parametrize("failed", [False, True])
def test_axe_finds_no_barrier_in_a_report(
    opened: Opened, hil: Hil, make_recording: Maker, report: Report, *, failed: bool
) -> None:
    if failed:
        hil("identify", make_recording(samples=8), "--report", "r.html")
    else:
        Path("r.html").write_text(report[1], encoding="utf-8")
    package = find_spec("axe_core_python")
    assert package is not None
    assert package.origin is not None
    axe = Path(package.origin).with_name("axe.min.js").read_text(encoding="utf-8")
    store = "document.body.dataset.axe = JSON.stringify(found.violations.map((one) => [one.id, one.nodes[0].html]))"
    shown = opened(Path("r.html"), f"<script>{axe}</script><script>axe.run().then((found) => {{ {store} }})</script>")
    (found,) = re.findall(r'data-axe="(.*?)"', shown.stdout)
    assert json.loads(unescape(found)) == []


def test_the_command_line_that_made_a_report_is_in_it(
    make_recording: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.report.html_page.svg", lambda _: "<svg/>")
    monkeypatch.setattr("hil.report.html_page.svg", lambda _: "<svg/>")
    path = make_recording(samples=400, noise=2e-4)
    words = ["identify", str(path), "--model", "linear", "--trials", "1", "--report", str(tmp_path / "r.html")]
    monkeypatch.setattr("sys.argv", ["hil", *words])
    assert run(words) == 0
    assert f"--report {tmp_path / 'r.html'}" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_a_picture_is_drawn_once_and_no_garbage_is_collected_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[bool] = []
    draw = Figure.draw

    def counted(figure: Figure, renderer: RendererBase) -> None:
        seen.append(gc.isenabled())
        draw(figure, renderer)

    monkeypatch.setattr(Figure, "draw", counted)
    picture = Picture("p", "Picture", "A panel.", lambda: canvas(1, 1, (4, 3))[0])
    write(Page("t", "s", ("v",), [], [Section("n")], [picture], [], {}), tmp_path / "p.html", force=True)
    assert seen == [False]
    assert gc.isenabled()
