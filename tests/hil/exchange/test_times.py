"""What a column of times may be: units, direction, counters that wrap, missing fractions, rows without times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.errors import WrongUse
from hil.exchange.importer import Column, Imported, import_table
from hil.recording.reader import Array, Recording

TIME = np.arange(1000) / 100.0
TORQUE, ANGLE = 0.1 * np.sin(9.0 * TIME), 0.2 * np.cos(11.0 * TIME)


def imported(
    folder: Path, head: str, *columns: Array | list[str], time: str | None = "t", unit: str | None = None, **more: float
) -> Imported:
    """Import a table of `columns`, torque and angle under the headings `head`."""
    rows = zip(*columns, TORQUE, ANGLE, strict=True)
    lines = [",".join(one if isinstance(one, str) else repr(float(one)) for one in row) for row in rows]
    (folder / "a.csv").write_text("\n".join([f"{head},tau [N*m],q [rad]".lstrip(","), *lines, ""]))
    named = {"torque": Column("tau"), "dtheta": Column("q")} | ({} if time is None else {"time": Column(time, unit)})
    return import_table(folder / "a.csv", folder / "a.h5", named, [], force=True, **more)  # type: ignore[arg-type]


def check(folder: Path, done: Imported, said: str, within: float = 1e-6) -> None:
    """Check the times of the recording against TIME, and what was said."""
    assert said in " ".join(one.message for one in done.diagnostics)
    with Recording(folder / "a.h5") as recording:
        time, torque = recording.channel("time"), recording.channel("torque")
    np.testing.assert_allclose(torque, TORQUE)
    np.testing.assert_allclose(time - time[5], TIME - TIME[5], atol=within)


LATER = TIME + 0.3125  # the first second is not whole
DATES = [f"2024-05-01 10:00:{int(one):02d}" for one in LATER]


@pytest.mark.parametrize(
    ("head", "column", "unit", "said"),
    [
        ("t", DATES, None, "whole seconds"),
        ("t [s]", np.floor(LATER + 86_400.0), None, "whole seconds"),
        ("t", [f"{one:.5f}" for one in 45413.0 + LATER / 86400.0], "d", "multiples of"),
        ("t [s]", np.where(np.floor(LATER) < 5.0, np.floor(LATER), np.floor(LATER) + 3.0), None, "whole seconds"),
    ],
)
def test_whole_seconds_are_spread_evenly(
    tmp_path: Path, head: str, column: Array | list[str], unit: str | None, said: str
) -> None:
    done = imported(tmp_path, head, column, unit=unit)
    assert said in done.diagnostics[0].message
    with Recording(tmp_path / "a.h5") as recording:
        steps = np.diff(recording.channel("time"))
    assert np.count_nonzero(np.abs(steps - 0.01) > 0.1 * 0.01) <= 1  # the pause


def test_whole_seconds_with_an_unsteady_number_of_rows_are_refused_with_the_column_beside(tmp_path: Path) -> None:
    odd = 10.0 * (TIME / 10.0) ** 1.1
    with pytest.raises(WrongUse, match=r"whole seconds.*--time 't \+ '\"'\"'part of it'\"'\"'\[ms\]'"):
        imported(tmp_path, "t [s],part of it", np.floor(odd), np.floor(1e3 * (odd % 1.0)))
    with pytest.raises(WrongUse, match=r"whole seconds.*--rate 500$"):
        imported(tmp_path, "t [s]", np.floor(odd))


@pytest.mark.parametrize(
    ("head", "columns", "time"),
    [
        ("t [s],ms", (np.floor(LATER), np.round(1e3 * (LATER % 1.0))), "t + ms"),
        ("sec,nsec", (np.floor(LATER) + 1.7e9, np.round(1e9 * (LATER % 1.0))), "sec + nsec"),
        ("date,rest", (DATES, np.round(1e6 * (LATER % 1.0))), "date + rest[us]"),
    ],
)
def test_seconds_and_their_fraction_in_two_columns_are_summed(
    tmp_path: Path, head: str, columns: tuple[Array, ...], time: str
) -> None:
    check(tmp_path, imported(tmp_path, head, *columns, time=time), "", within=0.0011)


def test_two_columns_that_both_count_the_whole_time_are_no_sum(tmp_path: Path) -> None:
    with pytest.raises(WrongUse, match="'ms' passes 1 s, the step of 't', so it is no fraction"):
        imported(tmp_path, "t [s],ms", np.floor(TIME), np.round(1e3 * TIME), time="t + ms")


def test_the_newest_row_first_is_turned_round(tmp_path: Path) -> None:
    check(tmp_path, imported(tmp_path, "t [s]", 99.0 - TIME, time="-t"), "")  # a column that counts down
    done = imported(tmp_path, "t [s]", TIME[::-1].copy())
    assert "the newest row is the first" in done.diagnostics[0].message
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("torque"), TORQUE[::-1])
        np.testing.assert_allclose(recording.channel("time"), TIME, atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "tick", "span"),
    [("us", 1e-6, 2.0**30), ("ms", 1e-3, 2.0**15), ("us", 1e-6, 2.0**32), ("s", 1.0, 60.0), ("ms", 1e-3, 2.0**12)],
)
def test_a_counter_that_wraps_goes_on(tmp_path: Path, unit: str, tick: float, span: float) -> None:
    count = (TIME / tick + span - 3.21 / tick) % span
    check(tmp_path, imported(tmp_path, f"t [{unit}]", count), "begins anew")


def test_a_counter_of_an_unknown_range_that_wraps_twice_goes_on(tmp_path: Path) -> None:
    check(tmp_path, imported(tmp_path, "t [s]", (TIME + 1.0) % 3.7), "begins anew", within=0.006)


def test_days_are_recognised_and_read(tmp_path: Path) -> None:
    days = 45413.4 + TIME / 86400.0
    with pytest.raises(WrongUse, match="--time-unit d"):
        imported(tmp_path, "t", days)
    check(tmp_path, imported(tmp_path, "t", days, unit="d"), "", within=1e-5)
    check(tmp_path, imported(tmp_path, "t (days)", days), "", within=1e-5)


@pytest.mark.parametrize(("unit", "factor"), [("ms", r"1000\*t"), ("s", "t/1000")])
def test_a_heading_that_is_wrong_by_a_thousand_is_refused_unless_confirmed(
    tmp_path: Path, unit: str, factor: str
) -> None:
    times = TIME if unit == "ms" else 1e3 * TIME
    with pytest.raises(WrongUse, match=f"--time '?{factor}'?; where it is right: --time-unit {unit}"):
        imported(tmp_path, f"t [{unit}]", times)
    check(tmp_path, imported(tmp_path, f"t [{unit}]", times, time=factor.replace("\\", "")), "")
    imported(tmp_path, f"t [{unit}]", times, unit=unit)


def test_rows_without_a_time_are_counted_at_a_rate(tmp_path: Path) -> None:
    check(tmp_path, imported(tmp_path, "", time=None, rate=100.0), "")
    check(tmp_path, imported(tmp_path, "n", (np.arange(1000.0) * 10.0 + 6e4) % 65536.0, time="n", rate=100.0), "")
    with pytest.raises(WrongUse, match="no rate"):
        imported(tmp_path, "", time=None, rate=0.0)


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("Delta_X\t0.002\n", "500"),
        ("Sample Interval,2.000000e-03,s\n", "500"),
        ("# sampling rate: 1 kHz\n", "1000"),
        ("Abtastrate [Hz]: 250\n", "250"),
        ('"HResolution","+5.0E-04"\n', "2000"),
        ("fs = 100\n", "100"),
        ("dt (ms): 4\n", "250"),
        ("X,CH1,Start,Increment\nSequence,Volt,-1.0,2e-3\n", "500"),
        ("CH1(V),CH2(V),t0 = -6.0e+00, tInc = 4.0e-03\n", "250"),
        ("Rate this test: 5 of 5\n", None),
    ],
)
def test_the_rate_that_a_file_states_is_named(tmp_path: Path, text: str, rate: str | None) -> None:
    (tmp_path / "a.csv").write_text(text + "tau [N*m],q [rad]\n" + "0.1,0.2\n0.2,0.3\n" * 9)
    said = "such as --rate 500" if rate is None else f"--rate {rate}, as the file says"
    with pytest.raises(WrongUse, match=said):
        import_table(tmp_path / "a.csv", tmp_path / "a.h5", {"torque": Column("tau"), "dtheta": Column("q")}, [])
