"""What stands around the numbers of a text table: preambles, headings, units, stamps and labels of monitors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.errors import WrongUse
from hil.exchange.columns import open_table

COUNT = 30
ROWS = [(0.002 * at, 0.1 * np.sin(at), 0.2 * np.cos(at)) for at in range(COUNT)]


def written(form: str, mark: str = "\n") -> str:
    return mark.join(form.format(*row, s=f"12:00:{row[0]:06.3f}") for row in ROWS) + "\n"


PLAIN = written("{0:.6f},{1:.6f},{2:.6f}")
TEK = ["Record Length,4e3", "Sample Interval,2e-3", "Source,CH3", "Vertical Units,V", "Horizontal Units,s"]
BESIDE = "".join(
    f"{TEK[at] if at < len(TEK) else ','},,{line},\n" for at, line in enumerate(PLAIN.splitlines())
)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "titles", "time"),
    [
        ("x-axis,1,2\nsecond,Volt,Volt\n" + PLAIN, ["x-axis [second]", "1 [Volt]", "2 [Volt]"], "x-axis"),
        (BESIDE, ["preamble 0", "preamble 1", "preamble 2", "time [s]", "CH3 [V]", "CH4 [V]", ""], "time"),
        (
            "Model,SDS\nRecord Length,CH1:7000\nVertical Units,CH1:V\nSource,CH1,CH2\nSecond,Volt,Volt\n" + PLAIN,
            ["Source [Second]", "CH1 [Volt]", "CH2 [Volt]"],
            "Source",
        ),
        ("LECROY,12,Waveform\nSegments,1,SegmentSize,1002\nTime,A,B\n" + PLAIN, ["Time", "A", "B"], "Time"),
        ("in s,C1 in V,C2 in V\n" + PLAIN, ["in s", "C1 in V", "C2 in V"], "in s"),
        ("Clock,Motor,\nt,angle,angle\n" + PLAIN, ["t", "angle", "angle"], "t"),
        ("Clock,Motor,Joint\nt,angle,angle\n(s),(deg),(deg)\n" + PLAIN, None, "Clock t"),
        ("Time,Cell,Arm\n,Torque,Angle\n" + PLAIN, ["Time", "Torque", "Angle"], "Time"),
        (
            '"TraceName","T","CH1","CH2"\n"VUnit","s","V","V"\n"HUnit","s","s","s"\n'
            + ","
            + PLAIN.strip().replace("\n", "\n,"),
            ["TraceName", "T [s]", "CH1 [V]", "CH2 [V]"],
            "T",
        ),
        ("Zeit,A,B\ns,Nm,Grad\n9 Hz,8 Hz,7 Hz\nSTEP=1,N=1,N=2\n" + PLAIN, ["Zeit [s]", "A [Nm]", "B [Grad]"], "Zeit"),
        (
            '"HORZ_UNITS", "S"\n"VERT_UNITS", "S", "V", "V"\n"SIGNAL", "TIME", "CH1", "CH2"\n' + PLAIN,
            ["TIME [S]", "CH1 [V]", "CH2 [V]"],
            "TIME",
        ),
        ("t,a,b\n" + written("{0:.6e},{1:.6e},{2:.6e}").replace("e", "D"), ["t", "a", "b"], "t"),
        ("log of 3 runs\nt [s],a,b\n" + PLAIN, ["t [s]", "a", "b"], "t"),
        (written("[{s}] {1:.4f}, {2:.4f}"), None, None),
        ("[12:00:00.000] a,b\n" + written("[{s}] {1:.6f},{2:.6f}"), ["received [s]", "a", "b"], "received"),
        ("a b\n" + written("({0:.6f}) {1:.6f} {2:.6f}"), ["received", "a", "b"], "received"),
        (written("t: {0:.6f}, Cell torque: {1:.6f} Nm, q={2:.6f}"), ["t", "Cell torque [Nm]", "q"], "t"),
        (written("{s} -> tau={1:.6f}\tq={2:.6f}\tmode=2"), ["received [s]", "tau", "q", "mode"], "received"),
        (written("[INFO] [{0:.6f}] [node]: tau: {1:.6f} q: {2:.6f}"), ["received", "tau", "q"], "received"),
        (written("May  1 {s} rig motord[412]: tau={1:.6f} q={2:.6f}"), ["received [s]", "tau", "q"], "received"),
        (written("I (412) arm: t={0:.6f} tau={1:.6f} q={2:.6f}"), ["received", "t", "tau", "q"], "t"),
        (written("{s} INFO arm: tau={1:.6f} q={2:.6f}"), ["received [s]", "tau", "q"], "received"),
        (written("{s} - arm - INFO - tau={1:.6f} q={2:.6f}"), ["received [s]", "tau", "q"], "received"),
        (written("{{'t': {0:.6f}, 'tau': {1:.6f}, 'q': {2:.6f}}}"), ["t", "tau", "q"], "t"),
        (written("{0:.6f}: tau {1:.6f}"), None, None),
        ("start\n" + written("{0:.6f}; tau: {1:.6f}; q: {2:.6f}"), ["number", "tau", "q"], "number"),
        (written("tau: {1:.6f}, q: {2:.6f}, t: {0:.6f}", "\ntau: 0.5\n"), ["tau", "q", "t"], "t"),
    ],
)
def test_numbers_are_found_below_and_beside_whatever_stands_around_them(
    tmp_path: Path, text: str, titles: list[str] | None, time: str | None
) -> None:
    (tmp_path / "a.txt").write_text(text)
    if time is None:  # no heading at all
        with pytest.raises(Exception, match=r"no headings|no rows"):
            open_table(tmp_path / "a.txt")
        return
    table = open_table(tmp_path / "a.txt")
    assert titles is None or list(table.titles) == titles
    found = table.read([time], [])[0][0]
    found = found[np.isfinite(found)]
    np.testing.assert_allclose(np.diff(found), 0.002, atol=1e-6)
    assert len(found) >= COUNT - 1


def test_the_first_rows_are_read_where_a_decimal_comma_looks_like_a_separator(tmp_path: Path) -> None:
    values = [*range(600, 605), *range(9005, 9030)]
    rows = "".join(f"{0.5 * at:.3f} {value:,.3f} {1100 + at}.25\n" for at, value in enumerate(values))
    (tmp_path / "a.txt").write_text("t a b\n" + rows.translate(str.maketrans(".,", ",.")))
    found, _ = open_table(tmp_path / "a.txt").read(["t", "a"], [])
    np.testing.assert_array_equal(found, [0.5 * np.arange(30), values])


def test_spaces_within_headings_shift_no_column_beside_a_date(tmp_path: Path) -> None:
    body = written("{1:.6f} 2024-05-01 {s} {2:.6f} 0.5")
    (tmp_path / "a.txt").write_text("tau date time q b\n" + body)
    np.testing.assert_allclose(
        open_table(tmp_path / "a.txt").read(["q"], [])[0][0], [row[2] for row in ROWS], atol=1e-6
    )
    (tmp_path / "a.txt").write_text("load cell time q b\n" + body)
    with pytest.raises(WrongUse, match="date 2024-05-01 stands under the heading 'cell'"):
        open_table(tmp_path / "a.txt")
    (tmp_path / "a.txt").write_text("t load cell q\n" + PLAIN.replace(",", " "))
    with pytest.raises(WrongUse, match="4 words stand above rows of 3 cells"):
        open_table(tmp_path / "a.txt")


def test_a_line_of_units_that_lacks_one_gives_none_between_spaces(tmp_path: Path) -> None:
    body = PLAIN.replace(",", " ")
    for units, titles in (("s Nm rad", ["t [s]", "a [Nm]", "b [rad]"]), ("Nm rad", ["t", "a", "b"])):
        (tmp_path / "a.txt").write_text(f"t a b\n{units}\n{body}")
        assert list(open_table(tmp_path / "a.txt").titles) == titles


@pytest.mark.parametrize(("last", "is_plain"), [("", True), ("1.000,5;1,5;2,5\n", False)])
def test_numpy_reads_a_plain_body_with_decimal_commas_too(
    tmp_path: Path, last: str, is_plain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hil.exchange.text import plain

    read, found = plain.numbers, list[object]()

    def numbers(*given: Any) -> object:
        found.append(read(*given))
        return found[-1]

    monkeypatch.setattr(plain, "numbers", numbers)
    (tmp_path / "a.csv").write_text("t;a;b\n" + PLAIN.replace(",", ";").replace(".", ",") + last)
    rows, _ = open_table(tmp_path / "a.csv").read(["a", "t"], [])
    np.testing.assert_allclose(rows[0][:COUNT], [row[1] for row in ROWS], atol=1e-6)
    assert (found[0] is not None) == is_plain


def test_a_name_with_signs_is_a_name_in_a_sum_too(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x-axis,x,cell+arm (Nm)\n" + PLAIN)
    table = open_table(tmp_path / "a.csv")
    found = table.terms("2*x-axis - cell+arm/4 + x")
    assert {one.column: one.factor for one in found} == {"x-axis": 2.0, "cell+arm": -0.25, "x": 1.0}


@pytest.mark.parametrize(
    ("old", "new", "count"),
    [
        ("", "", COUNT),
        (",0.1", ",+1e-1", COUNT),
        ("\n0.004", "\n\n0.004", COUNT),  # an empty line counts in the numbers of rows
        ("0.004000,", "0.004000,,", COUNT - 1),
        ("0.004000,", '"0.004000",', COUNT),
        ("0.004000,", "0.004000,nan", COUNT - 1),
        ("0.004000,0.", "0.004000,,0.", COUNT - 1),
        (",0.1", ",", COUNT),
        ("\n0.004000,", "\n,", COUNT),
        ("0.004000", '"0.004000\n"', COUNT),
        ("0.004000,", '"1,004.000",', COUNT),
        ("0.004000,", "n/a,", COUNT),
        ("\n", ",\n", COUNT),  # a column without a name
    ],
)
def test_a_plain_body_reads_the_same_through_numpy_as_cell_by_cell(
    tmp_path: Path, old: str, new: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hil.exchange.text import plain

    monkeypatch.setattr("hil.exchange.text.rows._BLOCK", 300)
    body = (4 * PLAIN).replace(old, new, 1) if old else 4 * PLAIN
    (tmp_path / "a.csv").write_text(("t,a,b,\n" if old == "\n" else "t,a,b\n") + body)
    found = open_table(tmp_path / "a.csv").read(["b", "t"], [])
    calls = []
    monkeypatch.setattr(plain, "numbers", lambda *given: calls.append(given))
    again = open_table(tmp_path / "a.csv").read(["b", "t"], [])
    assert calls
    assert len(found[1]) >= 3 * COUNT + count - 1
    for one, two in zip(found, again, strict=True):
        np.testing.assert_array_equal(one, two)
