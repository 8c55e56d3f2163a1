"""Many recordings in one page: every one has a row, and the page stays light."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.diagnostics import Diagnostic
from hil.identification.result import Identification
from hil.recording.writer import Header, write
from hil.report.joined_page import Entry, chart, table, verdict, write_page

from ..conftest import Hil
from .conftest import recording


def test_every_recording_has_a_row_its_pictures_and_its_warnings_and_twenty_are_under_five_megabytes(
    tmp_path: Path, found: Identification
) -> None:
    bad = Entry(tmp_path / "bad<.h5", None, "nothing moved", {"schema": "x"})
    entries = [Entry(tmp_path / "r.h5", found), Entry(tmp_path / "r.h5", found), bad]
    text = write_page(entries, tmp_path / "all.html", force=False).read_text(encoding="utf-8")
    assert text.count("<figure") == 1 + 2 * 2
    assert 10 * len(text) < 5_000_000
    assert verdict(entries) == "3 recordings: Kc of 2 and Bc of 2 can be trusted"
    assert verdict(entries) in text
    assert "bad&lt;.h5: nothing moved" in text
    names = re.findall(r' id="([^"]+)"', text)
    assert len(names) == len(set(names))


def test_a_recording_that_went_wrong_chooses_neither_unit_nor_axis_and_is_marked(found: Identification) -> None:
    wrong = Diagnostic("implausible", "noise", is_error=True)
    huge = replace(found["Kc"], value=5e3, ci95=(0.0, 1e4)), replace(found["Bc"], value=9.0, ci95=(0.0, 20.0))
    signals = replace(found.signals, torque=1e4 * found.signals.torque)
    bad = Entry(Path("bad.h5"), replace(found, estimates=huge, signals=signals, diagnostics=(wrong,)))
    entries = [Entry(Path("a.h5"), found), bad]
    headings, good, other = table(entries)
    assert headings[1:3] == ["Kc [mN m/rad]", "Bc [mN m s/rad]"]
    assert good == table(entries[:1])[1]
    assert other[1].endswith("(not trusted)")
    for panel in chart(entries).panels:
        assert panel.names == ["a", "bad (not trusted)"]
        assert len(panel.lines[0].x) == len(chart(entries[:1]).panels[0].lines[0].x)


@pytest.mark.study
def test_the_command_joins_recordings_and_says_which_has_no_result(hil: Hil, tmp_path: Path) -> None:
    recording(tmp_path / "a.h5", samples=800)
    time = np.arange(100) / 500.0
    still = {"time": time, "torque": 0.0 * time, "dtheta": 0.0 * time}
    write(tmp_path / "b.h5", Header(profile={"kind": "imported"}), still)
    status, out, err = hil("report", "a.h5", "b.h5", "--model", "linear", "--workers", "1", "-o", "all.html")
    assert (status, out) == (1, "2 recordings: Kc of 1 and Bc of 1 can be trusted\n")
    assert err.endswith("wrote all.html\n")
    text = (tmp_path / "all.html").read_text(encoding="utf-8")
    [embedded] = re.findall(r'<script type="application/json" id="result">(.*?)</script>', text, re.DOTALL)
    assert [one["recordings"][0] for one in json.loads(embedded)["results"]] == ["a.h5", "b.h5"]
    assert hil("report", "a.h5", "-o", "all.html", "--workers", "1")[0] == 2
    assert hil("report", "a.h5", "-o", "all.pdf", "--workers", "1")[0] == 2
