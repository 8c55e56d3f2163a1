"""The report: one file that stands alone, whose numbers are those of the JSON and whose texts cannot become markup."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil as api
from hil.cli.app import run
from hil.identification.result import Identification
from hil.recording.channels import Row
from hil.recording.writer import Header, RecordingWriter
from hil.report.chart import Chart, Line, Panel, Scale
from hil.report.formatting import Section
from hil.report.html_page import Page, Picture, write
from hil.report.pictures import result as drawing
from hil.report.pictures.files import write_pictures
from hil.report.pictures.thinning import loop_pieces, trace_rows

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


def test_nothing_from_a_file_becomes_markup(tmp_path: Path, found: Identification) -> None:
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


def test_a_table_with_the_heading_of_a_picture_stands_below_it_and_every_heading_stands_once(tmp_path: Path) -> None:
    line = Line("", np.arange(2.0), np.arange(2.0))
    pictures = [Picture(name, name, "1", lambda: Chart([Panel("x", "y", [line])])) for name in "abc"]
    sections = [Section("first"), Section("c", [["", "of c"]]), Section("last", lines=["of last"])]
    page = Page("", "", [""], [], sections, pictures, [], {})
    text = write(page, tmp_path / "p.html", force=False).read_text(encoding="utf-8")
    assert re.findall("<h2>(.*?)</h2>", text) == ["first", "a", "b", "c", "last", "Provenance"]
    assert text.index('<details id="c">') < text.index("table: c") < text.index("of last")


def test_the_pictures_that_a_command_looks_for_before_it_works_are_all_that_are_drawn(
    answer: api.IdentificationResult,
) -> None:
    assert {one.name for one in drawing.pictures(answer.identification)} <= set(drawing.NAMES)


def test_two_pictures_are_on_the_first_page_and_the_rest_is_folded_below_links_to_it(report: Report) -> None:
    elements = Elements(report[1])
    order = [tag for tag, _ in elements.found if tag in {"figure", "nav", "details"}]
    assert order[:3] == ["figure", "figure", "nav"]
    folded = [one["id"] for one in elements.attributes("details")]
    links = [one["href"] for one in elements.attributes("a")]
    assert links == [f"#{name}" for name in folded]
    assert len(elements.attributes("figure")) == 2 + sum("section" not in (name or "") for name in folded)


def test_a_report_suits_a_phone_the_dark_and_paper(report: Report) -> None:
    page = report[1]
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in Elements(page).attributes("meta")
    assert "@media (prefers-color-scheme: dark)" in page
    [printed] = re.findall(r"@media print \{(.*?)</style>", page, re.DOTALL)
    assert "section, details, figure, table, tr, li, .verdict { break-inside: avoid; }" in printed  # none is split
    assert "zoom: .5" in printed  # so that two charts share a page
    assert re.search(r"@media \(max-width: 36rem\) .*\.numbers td { white-space: normal; }", page)  # units stay


def test_a_report_is_made_without_matplotlib(report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert report[0].report(tmp_path / "again.html").stat().st_size > 50_000
    with pytest.raises(api.WrongUse, match=r"pip install 'hil\[plot\]'"):
        report[0].plot()


def unpacked(packed: Any) -> list[float]:
    """The values of an array in a page, NaN where there is none."""
    if isinstance(packed, list):
        return [np.nan if one is None else one for one in packed]
    counts = np.frombuffer(base64.b64decode(packed["data"]), "<u2")
    values = [np.nan if one == 65_535 else packed["low"] + packed["step"] * one for one in counts.tolist()]
    return [10.0**one for one in values] if packed["logarithm"] else values


@pytest.mark.parametrize("count", [5, 1000])
@pytest.mark.parametrize("scale", ["linear", "log"])
def test_a_chart_holds_its_values_within_a_screens_resolution_and_where_a_line_is_interrupted(
    count: int, scale: Scale
) -> None:
    x, values = np.linspace(0.0, 3.0, count), np.geomspace(1e-6, 10.0, count)
    values[2] = np.nan
    lines = [Line("</script>", x, values, "soft"), Line("twice", x, 2.0 * values)]
    table = json.loads(Chart([Panel("t [s]", "y", lines, scale=scale)]).as_json())
    first, second = table["panels"][0]["lines"]
    assert first["x"] == second["x"]
    np.testing.assert_allclose(unpacked(table["arrays"][first["x"]]), x, atol=1e-4)
    read = np.array(unpacked(table["arrays"][first["y"]]))
    is_log = scale == "log"
    np.testing.assert_allclose(read, values, rtol=3e-4 if is_log else 0.0, atol=0.0 if is_log else 2e-4)


def test_the_extremes_of_a_long_recording_are_drawn_and_its_loop_joins_only_samples_that_follow_each_other() -> None:
    signal = np.zeros(200_000)
    signal[123_457], signal[77_777] = 5.0, -3.0
    rows = trace_rows(signal, 0.1 * signal)
    assert {123_457, 77_777} <= set(rows.tolist())
    assert len(rows) < 10_000
    (time,) = loop_pieces(np.arange(200_000.0))
    steps = np.diff(time)
    np.testing.assert_array_equal(steps[np.isfinite(steps)], 1.0)
    assert 15_000 < np.isfinite(steps).sum() <= 20_000
    assert np.nanmax(time) == 199_999.0


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


@pytest.mark.study
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
    picture = Picture(
        "p", "Picture", "A panel.", lambda: Chart([Panel("x", "y", [Line("", np.arange(2.0), np.arange(2.0))])])
    )
    (path,) = write_pictures([picture], tmp_path / "new", force=False)
    assert path.name == "p.png"
    assert path.read_bytes().startswith(b"\x89PNG")


def test_inspect_draws_the_recording_and_refuses_another_format(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(samples=400, noise=2e-4)
    assert hil("inspect", path, "--plot", "a").status == 0
    assert Path("a", f"{path.stem}.png").read_bytes().startswith(b"\x89PNG")
    assert hil("inspect", path, "--plot", "a").status == 2
    ended = hil("inspect", path, "--plot", "a.svg")
    assert (ended.status, "a.svg is the name of a picture" in ended.err) == (2, True)


@pytest.mark.study
def test_a_report_of_a_long_recording_is_smaller_than_600_kilobytes(tmp_path: Path) -> None:
    many = api.identify(recording(tmp_path / "many.h5", samples=40_000), "linear", trials=4)
    assert many.report(tmp_path / "many.html").stat().st_size < 600_000


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
    legends = re.findall(r'class="u-label">(.*?)</div>.*?class="u-value">(.*?)</td>', whole.stdout)
    assert len(legends) == 5  # time twice, measured, model, error: the range without a cursor
    assert all(re.fullmatch(r"-?[\d.]+(e-\d+)? to [\d.]+(e-\d+)?", value) for _, value in legends)
    assert embedded(whole.stdout) == json.loads(json.dumps(result.as_json()))
    first, last = range_shown(whole.stdout)
    low, high = range_shown(near.stdout)
    assert high - low == pytest.approx((last - first) / 2.0, rel=0.01)
    assert low == pytest.approx(first + (last - first) / 4.0, rel=0.01)
    for shown in (whole, near):
        assert shown.stdout.count("<canvas") == 3  # the loop, and torque and error over time
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
    words = ["--model", "linear", "--trials", "1", "--report", str(tmp_path / "r.html")]
    monkeypatch.setattr("sys.argv", ["hil", "identify", str(make_recording(samples=400, noise=2e-4)), *words])
    assert run(sys.argv[1:]) == 0
    assert f"--report {tmp_path / 'r.html'}" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_no_text_of_a_file_steers_the_browser(tmp_path: Path) -> None:
    """A page is text as a terminal shows it: without escape sequences, marks of direction and halves of characters."""
    title = "\x1b[2J\u202e\x00\ud800\u2028"
    write(
        Page(title, title, (title,), [], [Section(title, [[title]])], [], [(title, title)], {}),
        tmp_path / "p.html",
        force=True,
    )
    text = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert not set(title) - set("[2J") & set(text)
    assert "\\x1b[2J\\u202e" in text
