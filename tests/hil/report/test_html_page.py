"""The report: one file that stands alone, whose numbers are those of the JSON and whose texts cannot become markup."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

import hil as api
from hil.cli.app import run
from hil.recording.channels import Row
from hil.recording.writer import Header, RecordingWriter
from hil.report.html_page import Page, Section, write

from ..conftest import Hil, Maker


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


@pytest.fixture
def report(make_recording: Maker, tmp_path: Path) -> tuple[api.IdentificationResult, str]:
    result = api.identify(make_recording(noise=2e-4), "linear", trials=1)
    return result, result.report(tmp_path / "r.html", "hil identify a.h5").read_text(encoding="utf-8")


def embedded(page: str) -> dict[str, Any]:
    (text,) = re.findall(r'<script type="application/json" id="result">(.+?)</script>', page, re.DOTALL)
    found: dict[str, Any] = json.loads(text)
    return found


def test_a_report_holds_the_json_object_and_says_its_numbers_first(
    report: tuple[api.IdentificationResult, str],
) -> None:
    result, page = report
    assert embedded(page) == json.loads(json.dumps(result.as_json()))
    elements = Elements(page)
    assert elements.text("title") == f"a.h5: {result}"
    assert page.index(str(result), page.index("<body>")) < page.index("<table")
    assert result.identification.recordings[0].name in elements.text("h1")
    assert "hil identify a.h5" in page[page.index("Provenance") :]


def test_a_report_needs_no_network_and_no_other_file(report: tuple[api.IdentificationResult, str]) -> None:
    page = report[1]
    addresses = set(re.findall(r"https?://[^\s\"'<>)]+", page))
    assert {address for address in addresses if not address.startswith("http://www.w3.org/")} == set()
    for tag, attributes in Elements(page).found:
        assert tag not in {"link", "iframe", "object", "img"}
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:image/png;base64,"))


def test_every_picture_has_a_sentence_with_its_numbers(report: tuple[api.IdentificationResult, str]) -> None:
    elements = Elements(report[1])
    pictures = [found for found in elements.attributes("div") if found.get("role") == "img"]
    assert len(pictures) == len(elements.attributes("figure")) >= 5
    for picture in pictures:
        assert re.search(r"\d", picture["aria-label"] or "")
    names = [found["id"] for tag, found in elements.found if "id" in found]
    assert len(names) == len(set(names))


def test_a_report_suits_a_phone_the_dark_and_paper(report: tuple[api.IdentificationResult, str]) -> None:
    page = report[1]
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in Elements(page).attributes("meta")
    assert "@media (prefers-color-scheme: dark)" in page
    assert "@media print" in page
    assert "currentColor" in page
    assert "#010203" not in page


def test_nothing_from_a_file_becomes_markup(tmp_path: Path, make_recording: Maker) -> None:
    evil = '</script><script>alert("1")</script>&amp;$x$'
    path = tmp_path / "a<b>&'$x$.h5"
    path.write_bytes(make_recording(noise=2e-4).read_bytes())
    plain = Elements(api.identify(path, "linear", trials=1).report(tmp_path / "r.html").read_text(encoding="utf-8"))
    assert plain.text("title").startswith("a<b>&'$x$.h5: ")
    page = Page(
        evil, evil, [evil], [], [Section(evil, [["", evil], [evil, evil]], [evil])], [], [(evil, evil)], {evil: evil}
    )
    text = write(page, tmp_path / "evil.html", force=False).read_text(encoding="utf-8")
    assert len(Elements(text).attributes("script")) == 1
    assert embedded(text) == {evil: evil}


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


def test_the_pictures_are_written_into_a_folder_and_one_that_is_there_is_kept(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(noise=2e-4)
    words = ("identify", path, "--model", "linear", "--trials", 1, "--plot", "p")
    assert hil(*words).status == 0
    names = {item.name for item in Path("p").iterdir()}
    assert {"traces.png", "loop.png", "residuals.png", "intervals.png", "fit.png", "dynamic.png"} <= names
    assert all((Path("p") / name).read_bytes().startswith(b"\x89PNG") for name in names)
    ended = hil(*words)
    assert (ended.status, "traces.png exists" in ended.err) == (2, True)
    assert hil(*words, "--force").status == 0


def test_inspect_draws_the_recording_and_refuses_another_format(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(noise=2e-4)
    assert hil("inspect", path, "--plot", "a.png").status == 0
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    assert hil("inspect", path, "--plot", "a.png").status == 2
    assert hil("inspect", path, "--plot", "a.png", "--force").status == 0
    ended = hil("inspect", path, "--plot", "a.svg")
    assert (ended.status, "a.svg is no name of a picture" in ended.err) == (2, True)


def test_twenty_recordings_make_less_than_five_megabytes(tmp_path: Path, make_recording: Maker) -> None:
    """As each has its own pictures; the size does not grow with the samples."""
    few = api.identify(make_recording("few.h5", samples=10_000, noise=2e-4), "linear", trials=1)
    many = api.identify(make_recording("many.h5", samples=40_000, noise=2e-4), "linear", trials=1)
    sizes = [one.report(tmp_path / "r.html").stat().st_size for one in (few, many)]
    assert max(sizes) * 20 < 5_000_000
    assert sizes[1] < 1.2 * sizes[0]


def test_a_browser_opens_the_report_from_disk_and_shows_the_numbers(make_recording: Maker, tmp_path: Path) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("REPORT NOT OPENED IN A BROWSER: there is no chromium; apt-get install chromium")
    result = api.identify(make_recording(noise=2e-4), "linear", trials=1)
    page = result.report(tmp_path / "r.html")
    words = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    shown = subprocess.run(
        [browser, *words, "--enable-logging=stderr", "--dump-dom", page.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert str(result) in shown.stdout
    assert embedded(shown.stdout) == json.loads(json.dumps(result.as_json()))
    assert "CONSOLE" not in shown.stderr  # neither errors of scripts nor resources that are missing


def test_the_command_line_that_made_a_report_is_in_it(
    make_recording: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make_recording(noise=2e-4)
    words = ["identify", str(path), "--model", "linear", "--trials", "1", "--report", str(tmp_path / "r.html")]
    monkeypatch.setattr("sys.argv", ["hil", *words])
    assert run(words) == 0
    assert f"--report {tmp_path / 'r.html'}" in (tmp_path / "r.html").read_text(encoding="utf-8")
