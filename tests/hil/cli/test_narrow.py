"""Tables on terminals of any width: no word is broken, no column vanishes."""

from __future__ import annotations

import pytest

from hil.cli.terminal import out_section
from hil.report.formatting import Section

HEADINGS = ["joint", "setting", "recordings", "Kc, mN m/rad", "Bc, mN m s/rad", "state"]
ROWS = [
    ["thumb-cmc-flexion", "2 N, chirp", "2 of 2", "15.91 ± 0.05", "0.160 ± 0.006", "repeats"],
    ["wrist-deviation", "chirp", "1 of 2", "no result", "0.1840 ± 0.0021", "Kc does not repeat; Bc stands out"],
]


@pytest.mark.parametrize("width", [20, 30, 40, 60, 79, 80, 120, 200])
def test_every_word_of_a_table_is_whole_at_every_width(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    out_section(Section("simulated hand", [HEADINGS, *ROWS]))
    words = set(capsys.readouterr().out.replace(":", " ").replace(",", " ").split())
    for cell in [*HEADINGS, *(cell for row in ROWS for cell in row)]:
        assert set(cell.replace(",", " ").split()) <= words


def test_a_table_that_fits_stays_a_table(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    out_section(Section("simulated hand", [HEADINGS, *ROWS]))
    assert any("thumb-cmc-flexion" in line and "repeats" in line for line in capsys.readouterr().out.splitlines())
