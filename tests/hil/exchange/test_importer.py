"""Tables into recordings: units, signs, filters, and a sentence with the row for everything that is wrong."""

from __future__ import annotations

import gzip
import math
import re
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.api.recordings import load
from hil.errors import WrongUse
from hil.exchange.columns import open_table
from hil.exchange.importer import Column, import_table
from hil.exchange.row_filter import RowFilter
from hil.identification.same_stand import other_joints_diagnostics
from hil.recording.reader import Array, Recording
from hil.signals.prepare import prepare
from hil.signals.source import open_sources
from hil.stand.file import parse

TABLE = "TIME,POS,TAU,run\n0.5,0.25,10,1\n0.6,0.5,20,1\n0.7,-0.25,30,2\n"
PLAIN = {"time": Column("TIME", "s"), "torque": Column("TAU", "mN*m"), "dtheta": Column("POS", "rev")}


def imported(tmp_path: Path, text: str, where: tuple[str, ...] = (), **columns: Column) -> Recording:
    source = tmp_path / "a.csv"
    source.write_bytes(text.encode())
    import_table(source, tmp_path / "a.h5", PLAIN | columns, [RowFilter.parse(item) for item in where])
    return Recording(tmp_path / "a.h5")


def test_columns_arrive_in_si_and_time_starts_at_zero(tmp_path: Path) -> None:
    with imported(tmp_path, TABLE) as recording:
        np.testing.assert_allclose(recording.channel("time"), [0.0, 0.1, 0.2])
        np.testing.assert_allclose(recording.channel("torque"), [0.01, 0.02, 0.03])
        np.testing.assert_allclose(recording.channel("dtheta"), np.array([0.5, 1.0, -0.5]) * math.pi)
        assert np.isnan(recording.channel("dtheta_dot")).all()
        assert recording.profile == {"kind": "imported", "source": "a.csv", "where": ""}


@pytest.mark.parametrize(("channel", "name"), [("torque", "TIME"), ("dtheta", "TIME"), ("torque", "POS")])
def test_one_column_is_not_read_as_two_channels(tmp_path: Path, channel: str, name: str) -> None:
    unit = PLAIN[channel].unit
    with pytest.raises(WrongUse, match=f"are both '{name}'"):
        imported(tmp_path, TABLE, (), **{channel: Column(name, unit)})


@pytest.mark.parametrize(
    ("where", "kept"), [(("run != 1",), [30.0]), (("TAU>=20", "TAU<30"), [20.0]), (("POS<=-0.25",), [30.0])]
)
def test_only_rows_that_meet_every_condition_are_kept(
    tmp_path: Path, where: tuple[str, ...], kept: list[float]
) -> None:
    with imported(tmp_path, TABLE, where) as recording:
        np.testing.assert_allclose(recording.channel("torque") * 1e3, kept)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.csv.gz", gzip.compress(b"\xef\xbb\xbf" + TABLE.replace("\n", "\r\n").encode())),
        ("a.txt", TABLE.replace(",", "\t").encode("utf-16")),
        ("a.csv", TABLE.replace(",", ";").encode()),
    ],
    ids=["gzipped, with a byte order mark and CRLF", "the unicode text of spreadsheets", "semicolons"],
)
def test_other_texts_read_the_same(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    assert import_table(tmp_path / name, tmp_path / "b.h5", PLAIN, []).samples == 3


def test_semicolons_and_decimal_commas_read_as_points_do(tmp_path: Path) -> None:
    german = TABLE.replace(",", ";").replace(".", ",").replace("10", "1,000").replace("20", "2e1")
    with imported(tmp_path, german) as recording:
        np.testing.assert_allclose(recording.channel("torque"), [0.001, 0.02, 0.03])
        np.testing.assert_allclose(recording.channel("dtheta"), np.array([0.5, 1.0, -0.5]) * math.pi)


def test_rows_that_a_logger_wrote_twice_count_once_and_those_of_a_coarse_clock_each(tmp_path: Path) -> None:
    twice = [f"{0.01 * k:.2f},{k},{0.1 * k:.1f}" for k in range(50) for _ in range(1 + (k % 9 == 0))]
    twice[:2] = ["0.00,,0.0"] * 2
    coarse = [f"{0.1 * (k // 10):.1f},{k // 2},{0.1 * (k // 2):.1f}" for k in range(50)]

    for rows, count, codes in ((twice, 50, ["mended-table"]), (coarse, 50, [])):
        source = tmp_path / "log.csv"
        source.write_text("\n".join(["time [s],torque [N*m],dtheta [rad]", *rows]))
        columns = {name: Column(name) for name in ("time", "torque", "dtheta")}
        found = import_table(source, tmp_path / "a.h5", columns, [], force=True)
        assert found.samples == count
        assert [one.code for one in found.diagnostics] == codes


def test_a_sign_and_a_scale_are_put_on_a_column(tmp_path: Path) -> None:
    with imported(tmp_path, TABLE, torque=Column("TAU", "mN*m", -1.0), dtheta=Column("POS", "rev", 0.25)) as recording:
        np.testing.assert_allclose(recording.channel("torque"), [-0.01, -0.02, -0.03])
        np.testing.assert_allclose(recording.channel("dtheta"), np.array([0.5, 1.0, -0.5]) * math.pi / 4)


@pytest.mark.parametrize("title", ["tau (mN m)", "tau_mNm"])
def test_a_unit_in_the_heading_is_taken(tmp_path: Path, title: str) -> None:
    name = title.split(" ", maxsplit=1)[0]  # "tau" finds "tau [mNm]"
    with imported(tmp_path, TABLE.replace("TAU", title), torque=Column(name)) as recording:
        np.testing.assert_allclose(recording.channel("torque"), [0.01, 0.02, 0.03])


def test_what_was_understood_of_the_units_is_handed_back(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE.replace("TAU", "tau [mNm]").replace("POS", "angle_deg"))
    columns = {"time": Column("TIME", "s"), "torque": Column("tau"), "dtheta": Column("angle_deg")}
    done = import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [])
    assert done.units == {"time": "s", "torque": "mNm", "dtheta": "deg"}
    assert done.samples == 3
    assert done.duration == pytest.approx(0.2)


def test_an_empty_cell_is_a_nan(tmp_path: Path) -> None:
    with imported(tmp_path, TABLE.replace("0.6,0.5,20", "0.6,0.5,")) as recording:
        assert np.isnan(recording.channel("torque")).tolist() == [False, True, False]


@pytest.mark.parametrize(("sensor", "scale"), [("motor_torque", 1e-3), ("torque", 4e-3)])
def test_motor_columns_come_to_the_joint_through_the_stands_gear_and_a_cell_goes_with_them(
    tmp_path: Path, sensor: str, scale: float
) -> None:
    source = tmp_path / "a.csv"
    source.write_text("t,p,q\n0,8.0,1\n0.1,8.4,2\n")
    columns = {"time": Column("t", "s"), sensor: Column("q", "N*m", scale), "motor_position": Column("p", "rad")}
    import_table(source, tmp_path / "a.h5", columns, [], stand=parse("[stand]\ngear_ratio = 4.0\n"))
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("torque"), [0.004, 0.008])
        np.testing.assert_allclose(recording.channel("dtheta"), [0.0, 0.1])
        np.testing.assert_allclose(recording.channel("motor_position"), [8.0, 8.4])
        assert recording.stand_toml == "[stand]\ngear_ratio = 4.0\n"


@pytest.mark.study
def test_the_motors_own_inertia_and_friction_are_taken_off_what_was_imported(tmp_path: Path) -> None:
    """Equation (1) in closed form: an imported motor torque gives back the coupling's."""
    ratio, inertia, damping, kc, bc = 4.0, 2e-6, 1e-5, 0.02, 2e-4
    time, omega = np.arange(0.0, 4.0, 0.002), 2.0 * math.pi * 3.0
    angle, rate = 0.2 * np.sin(omega * time), 0.2 * omega * np.cos(omega * time)
    torque = (kc * angle + bc * rate) / ratio + ratio * (inertia * -(omega**2) * angle + damping * rate)
    rows = "\n".join(f"{t!r},{p!r},{q!r}" for t, p, q in zip(time, ratio * angle, torque, strict=True))
    (tmp_path / "a.csv").write_text(f"t,p,q\n{rows}\n".replace("np.float64(", "").replace(")", ""))
    columns = {"time": Column("t", "s"), "motor_torque": Column("q", "N*m"), "motor_position": Column("p", "rad")}
    text = f"[stand]\ngear_ratio = {ratio}\nmotor_inertia = {inertia}\nmotor_damping = {damping}\n"
    import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [], stand=parse(text))
    with Recording(tmp_path / "a.h5") as recording:
        signals = prepare(recording, parse(recording.stand_toml).stand)
    assert signals.torque_from == "motor"
    columns_of = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])
    found = np.linalg.lstsq(columns_of, signals.coupling_torque, rcond=None)[0]
    np.testing.assert_allclose(found, [kc, bc], rtol=0.01)


@pytest.mark.parametrize(
    ("text", "where", "said"),
    [
        (TABLE.replace("TAU", "tau"), (), "no column 'TAU'; did you mean 'tau'\\? it has TIME, POS, tau, run"),
        (TABLE.replace("run", "TAU"), (), "2 columns named 'TAU'"),
        (TABLE.replace("20", "twenty"), (), "row 3, column TAU: 'twenty' is not a number"),
        (TABLE.replace("20", "20 mNm"), (), "row 3, column TAU: '20 mNm' is not a number"),
        (TABLE.replace("20", "2_0"), (), "row 3, column TAU: '2_0' is not a number"),
        (TABLE.replace("20", "x" * 500), (), "column TAU: 'x{40}[.]{3}' is not a number"),
        (TABLE.replace(",", ";").replace("0.5;20", "0,5;20"), (), "both ways, '0.5' in row 2.*'0,5' in row 3"),
        ("TIME;POS;TAU\n0;1,234;1\n1;2,345;1\n", (), "'1,234' in row 2, column POS, may be a decimal or a thousand"),
        (TABLE.replace(",", ";").replace("10;", "1.234,5;"), (), "both ways, '0.5' in row 2.*'1.234,5' in row 2"),
        (TABLE.replace(".", ","), (), "row 2: 6 fields, but the header names 4.*separate the columns with semicolons"),
        (TABLE.replace("0.6,0.5,20,1", "0.6,0.5"), (), "row 3: 2 fields, but the header names 4.*was cut off"),
        (TABLE + '1.0,"2,3,4\n' + "5,6,7,8\n" * 20000, (), "near row.*longer than 131072 characters.*quotation mark"),
        (f'TIME,"{"x" * 131073}\n', (), "row 1: a field is longer than 131072 characters"),
        (
            TABLE.split("\n", 1)[1],
            (),
            r"no headings: .*above them .* its 4 columns, such as 'time \[s\],torque \[N\*m\],dth",
        ),
        ("0;0,07;0,2\n0,002;0,08;0,3\n", (), r"no headings: .* its 3 columns, such as 'time \[s\];torque"),
        ("0,5\t0,07\t0,2\n", (), "no headings: .* its 3 columns"),
        ("# rig 3\n# Smith\n" + TABLE.split("\n", 1)[1], (), "no headings: .* its 4 columns"),
        (TABLE.replace("0.6,", "05/01/2024 12:00,"), (), "row 3, column TIME: .*: write times as 2024-"),
        (TABLE.replace("20", "OL"), (), "'OL' is not a number: empty the cell where nothing was read"),
        (TABLE.replace("TAU", "TAUS"), (), "did you mean 'TAUS'"),
        (TABLE.replace("0.7", "0.1"), (), "row 4: the time goes backwards"),
        (TABLE.replace("0.7", ""), (), "row 4: the time is not a number, in 1 of 3 rows: delete these rows"),
        (TABLE, ("run==9",), "no row passes run==9"),
        (TABLE, ("speed==9",), "no column 'speed'"),
        (TABLE, ("run=1",), "write a column, one of"),
        (TABLE, ("run<one",), "'one' is no number and no time: compare a text with == or !="),
        ("TIME,POS,TAU\n", (), "no rows"),
        ("", (), r"a\.csv is empty"),
    ],
)
def test_what_is_wrong_with_a_table_is_said_with_its_row(
    tmp_path: Path, text: str, where: tuple[str, ...], said: str
) -> None:
    with pytest.raises(WrongUse, match=said.replace("'", "'")):
        imported(tmp_path, text, where)
    assert not (tmp_path / "a.h5").exists()


def test_an_unknown_unit_is_refused_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(WrongUse, match="did you mean 'mN\\*m'"):
        imported(tmp_path, TABLE, torque=Column("TAU", "mN*M"))


@pytest.mark.parametrize(
    ("title", "unit", "said"),
    [
        ("TAU [Nm]", "mN*m", "in Nm by its heading and in mN\\*m by the option"),
        ("TAU_Nm", "mN*m", "in Nm by its heading"),
        ("TAU [V]", None, "names 'V', an unknown unit of torque: give it with --torque-unit"),
        ("TAU (filtered)", None, "give it with --torque-unit"),
    ],
)
def test_a_heading_and_an_option_that_differ_are_refused(
    tmp_path: Path, title: str, unit: str | None, said: str
) -> None:
    with pytest.raises(WrongUse, match=said):
        imported(tmp_path, TABLE.replace("TAU", title), torque=Column(title, unit))


def test_a_heading_whose_brackets_hold_no_unit_gives_way_to_the_option(tmp_path: Path) -> None:
    with imported(tmp_path, TABLE.replace("TAU", "TAU (filtered)"), torque=Column("TAU", "mN*m")) as recording:
        np.testing.assert_allclose(recording.channel("torque"), [0.01, 0.02, 0.03])


@pytest.mark.parametrize("odd", [1e308, -math.inf, 1e-320, "signalling"])
@pytest.mark.parametrize("place", ["TIME", "POS", "TAU"])
def test_a_number_that_no_unit_can_convert_is_missing_or_refused_without_a_warning_of_numpy(
    tmp_path: Path, odd: float | str, place: str
) -> None:
    from scipy.io import savemat

    numbers = {"TIME": np.arange(1.0, 9.0), "POS": np.sin(np.arange(8.0)), "TAU": np.cos(np.arange(8.0))}
    if odd == "signalling":  # a NaN that raises the flag of an invalid operation in the next multiplication
        numbers[place].view(np.uint64)[-1] = 0x7FF0000000000001
    else:
        numbers[place][-1] = odd
    savemat(tmp_path / "a.mat", numbers)
    columns = {channel: Column(column.name, column.unit, 1e3) for channel, column in PLAIN.items()}
    columns["time"] = Column("TIME", "min")
    with nullcontext() if place != "TIME" else pytest.raises(WrongUse):
        assert import_table(tmp_path / "a.mat", tmp_path / "a.h5", columns, []).samples == 8


@pytest.mark.parametrize("scale", [0.0, math.nan, math.inf])
def test_a_scale_that_leaves_nothing_is_refused(tmp_path: Path, scale: float) -> None:
    with pytest.raises(WrongUse, match="torque cannot be scaled"):
        imported(tmp_path, TABLE, torque=Column("TAU", "mN*m", scale))


def test_a_motor_torque_for_a_stand_with_a_torque_cell_is_refused(tmp_path: Path) -> None:
    columns = {
        "time": Column("TIME", "s"),
        "motor_torque": Column("TAU", "N*m"),
        "motor_position": Column("POS", "rad"),
    }
    (tmp_path / "a.csv").write_text(TABLE)
    stand = parse('[stand]\ntorque_source = "joint"\n')
    with pytest.raises(WrongUse, match="name the torque cell's column with --torque"):
        import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [], stand=stand)


BARE = {"time": Column("TIME"), "torque": Column("TAU"), "dtheta": Column("POS")}


def test_columns_whose_units_nobody_states_are_refused_together_with_their_ranges(tmp_path: Path) -> None:
    with pytest.raises(WrongUse) as refusal:
        imported(tmp_path, TABLE, (), **BARE)
    said = str(refusal.value)
    for part in (
        "the unit of 'TIME' (0.5 to 0.7): give it with --time-unit, one of s, ms",
        "'TAU' (10 to 30): give it with --torque-unit, one of N*m, mN*m",
        "'POS' (-0.25 to 0.5): give it with --dtheta-unit, one of rad, mrad, deg",
    ):
        assert part in said
    assert not (tmp_path / "a.h5").exists()


def test_a_column_without_a_number_is_refused(tmp_path: Path) -> None:
    empty = re.sub(r",\d+,", ",,", TABLE)
    with pytest.raises(WrongUse, match=r"column 'TAU' holds no number"):
        imported(tmp_path, empty)


def test_a_sensors_own_unit_is_answered_with_the_option_of_its_factor(tmp_path: Path) -> None:
    columns = {"dtheta": Column("POS [counts]")}
    with pytest.raises(WrongUse, match=r"'counts', an unknown unit of angle: .* counts or volts .* --dtheta-scale"):
        imported(tmp_path, TABLE.replace("POS", "POS [counts]"), (), **columns)


def test_units_in_a_line_below_the_headings_are_read(tmp_path: Path) -> None:
    text = TABLE.replace("run\n", "run\nms,deg,mN m,-\n")
    with imported(tmp_path, text, (), **BARE) as recording:
        np.testing.assert_allclose(recording.channel("torque"), [0.01, 0.02, 0.03])
        np.testing.assert_allclose(recording.channel("time"), [0.0, 1e-4, 2e-4])
    with pytest.raises(WrongUse, match=r"row 4, column TAU .mN m.: 'twenty' is not a number"):
        imported(tmp_path, text.replace("20", "twenty"), (), **BARE)


UNITED = {"time": Column("t"), "torque": Column("tau"), "dtheta": Column("q")}
ROWS = "0.5,10,0.1\n0.6,20,0.2\n0.7,30,0.3\n"


@pytest.mark.parametrize(
    "text",
    [
        "# logger 1.2\n# rig 3, Smith, 2024\n\nt [s],tau [mN*m],q [rad]\n" + ROWS,
        "Settings;rate;1000\nWriter;2\n***end***\nt;tau;q\n\ns;mNm;rad\n".replace(";", ",") + ROWS,
        "Program\tx\nReader_Version\t2\n***End***\t\n\t\nt_s\ttau_mNm\tq_rad\tComment\n" + ROWS.replace(",", "\t"),
        "t[s] tau[mNm]  q[rad]\n" + ROWS.replace(",", "  "),
        "Y_Unit_Label\ts\tmNm\trad\nX0\t0\t0\nt\ttau\tq\tComment\n" + ROWS.replace(",", "\t"),
        "# Units: s, mNm, rad\nt,tau,q\n" + ROWS,
        "# t_s tau_mNm q_rad\n" + ROWS.replace(",", " ").replace("\n", " \n"),
        "t [s],tau [mNm],q [rad]\n" + ROWS.replace("\n", ",\n"),
        "t;tau_mNm;q_rad\n2024-05-01 23:59:59.9;10;0.1;\n2024-05-02T00:00:00;20;0.2;\n2024-05-02 00:00:00.1;30;0.3\n",
        "t,tau [mNm],q [rad]\n09:59:59.9,10,0.1\n10:00:00,20,0.2\n10:00:00.1,30,0.3\n",
    ],
    ids=["comments", "settings", "LabVIEW", "spaces", "labelled", "units", "savetxt", "trailing", "dates", "times"],
)  # fmt: skip
def test_tables_as_loggers_write_them_read_the_same(tmp_path: Path, text: str) -> None:
    with imported(tmp_path, text, (), **UNITED) as recording:
        np.testing.assert_allclose(recording.channel("time"), [0.0, 0.1, 0.2], atol=1e-6)
        np.testing.assert_allclose(recording.channel("torque"), [0.01, 0.02, 0.03])
        np.testing.assert_allclose(recording.channel("dtheta"), [0.1, 0.2, 0.3])


MOVING = np.column_stack([0.01 * np.arange(400), 0.5 * np.sin(0.3 * np.arange(400)), np.sin(0.3 * np.arange(400))])
LINES = [f"{t:.2f},{tau:.6f},{q:.6f}\n" for t, tau, q in MOVING.tolist()]
HEAD = "time [s],torque [N*m],angle [rad]\n"
NAMED = {"time": Column("time"), "torque": Column("torque"), "dtheta": Column("angle")}


def swapped(lines: list[str]) -> list[str]:
    """Rows as two threads write them."""
    return [lines[at + (1 if at % 10 == 0 else -1 if at % 10 == 1 else 0)] for at in range(len(lines))]


def clock(ms: int) -> str:
    """Return the time of day, ms after 23:59:59."""
    ms = (ms + 86_399_000) % 86_400_000
    return f"{ms // 3_600_000:02}:{ms // 60_000 % 60:02}:{ms // 1000 % 60:02}.{ms % 1000:03}"


@pytest.mark.parametrize(
    ("text", "lost", "said"),
    [
        ("rst:0x1 (POWERON),boot:0x13\nGains,1.0,2.0\n" + HEAD + "".join(LINES), 0, None),
        ("Operator,Smith,rig\n" + HEAD + "".join(LINES), 0, None),
        ("sep=;\n" + (HEAD + "".join(LINES)).replace(",", ";").replace(".", ","), 0, None),
        ("time,torque,angle,i\n(s),(Nm),(rad),(A)\n" + "".join(line[:-1] + ",1.5\n" for line in LINES), 0, None),
        ('"Test","A"\n"time","torque","angle"\n"sec","N-m",""\n' + "".join(LINES), 0, None),
        ("time (s) torque (N m) angle (rad)\n" + "".join(LINES).replace(",", " "), 0, None),
        ("".join(line + HEAD * (at % 90 == 0) for at, line in enumerate([HEAD, *LINES])), 0, None),
        (HEAD + "".join(LINES)[:-12], 1, "1 row is damaged"),
        (HEAD + "".join(LINES[:200]) + "1.9" + "\0" * 99 + "\nboot\n" + HEAD + "".join(LINES[200:]), 0, "NUL bytes"),
        (HEAD + "".join(swapped(LINES)), 0, "out of order, in 40 places"),
        (HEAD.replace(" [s]", "") + "".join(clock(10 * at) + line[4:] for at, line in enumerate(LINES)), 0, None),
        (
            HEAD.replace("[s]", "[us]")
            + "".join(f"{(2**32 - 10**6 + 10**4 * at) % 2**32}{line[4:]}" for at, line in enumerate(LINES)),
            0,
            "begins anew after 4294.967 s",
        ),
        (
            HEAD + "".join("0.00" * (at == 99) + line[4 * (at == 99) :] for at, line in enumerate(LINES)),
            1,
            "wrong time",
        ),
        (
            HEAD
            + "".join(LINES[:200])
            + "".join(f"{at / 100 + 0.5:.2f}{line[4:]}" for at, line in enumerate(LINES[200:])),
            0,
            "goes back by 1.49 s in row 202, because the clock was set. The rows from there on are read as after",
        ),
        (
            HEAD + "".join(LINES[:200] + [f"{at / 100:.2f}{line[4:]}" for at, line in enumerate(LINES[200:])]),
            0,
            "goes back by 1.99 s in row 202, to where it began: a further run begins there",
        ),
    ],
)
def test_a_log_is_read_as_it_was_meant_and_what_is_lost_is_said(
    tmp_path: Path, text: str, lost: int, said: str | None
) -> None:
    (tmp_path / "a.csv").write_text(text)
    dtheta = Column("angle", None if "(rad)" in text or "[rad]" in text else "rad")
    done = import_table(tmp_path / "a.csv", tmp_path / "a.h5", NAMED | {"dtheta": dtheta}, [])
    with Recording(tmp_path / "a.h5") as recording:
        time, torque, angle = (recording.channel(name) for name in ("time", "torque", "dtheta"))
    assert len(time) == len(MOVING) - lost
    assert (np.diff(time) > 0.009).all()
    np.testing.assert_allclose(torque, 0.5 * angle, atol=2e-6)
    assert said is None or said in done.diagnostics[0].message
    assert [one.code for one in done.diagnostics] == ["mended-table"] * (said is not None)


COUNTS = np.round(MOVING[:, 1] * 800).astype(int)
ANGLES = np.round(MOVING[:, 2] * 500).astype(int)


@pytest.mark.parametrize(
    ("torque", "angle", "codes"),
    [
        (COUNTS & 0xFFFF, ANGLES, ("wrap=65536", None)),
        (np.where(COUNTS < 0, 1024 - COUNTS, COUNTS), ANGLES, ("sign=1024", None)),
        ((COUNTS & 0x3FF) * 0.00269, ANGLES, ("wrap=2.75456", None)),
        (np.where(COUNTS < 0, 1024 - COUNTS, COUNTS), ANGLES & 0xFFFF, ("sign=1024", "wrap=65536")),
    ],
    ids=["two's complement", "sign bit", "10 bits, scaled", "both"],
)
def test_numbers_without_their_sign_are_recognised_and_read_right_with_the_code_that_is_offered(
    tmp_path: Path, torque: Array, angle: Array, codes: tuple[str | None, str | None]
) -> None:
    rows = zip(MOVING[:, 0].tolist(), torque.tolist(), angle.tolist(), strict=True)
    (tmp_path / "a.csv").write_text("t,q,a\n" + "".join(f"{t:.2f},{q:.10g},{a}\n" for t, q, a in rows))
    columns = {"time": Column("t", "s"), "torque": Column("q", "N*m"), "dtheta": Column("a", "rad", 0.002)}
    for channel, code in zip(("torque", "dtheta"), codes, strict=True):
        if code is not None:
            with pytest.raises(WrongUse, match=f"lack their sign.*--{channel}-code {code}"):
                import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [])
            columns[channel] = replace(columns[channel], code=code)
    import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [])
    with Recording(tmp_path / "a.h5") as recording:
        found, moved = recording.channel("torque"), recording.channel("dtheta")
    np.testing.assert_allclose(found, moved * (found @ moved) / (moved @ moved), atol=0.01 * np.ptp(found))


@pytest.mark.parametrize("steps", [1000 * (np.arange(400) % 40 < 20), np.full(400, 0.3), 1e300 * np.arange(400)])
def test_a_column_that_needs_no_code_is_imported(tmp_path: Path, steps: Array) -> None:
    """A torque in one direction, one that never changes, and one beyond any sensor."""
    rows = zip(MOVING[:, 0].tolist(), steps.tolist(), (0.001 * steps).tolist(), strict=True)
    (tmp_path / "a.csv").write_text("t,q,a\n" + "".join(f"{t:.2f},{q},{a}\n" for t, q, a in rows))
    columns = {"time": Column("t", "s"), "torque": Column("q", "mN*m"), "dtheta": Column("a", "rad")}
    assert import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, []).samples == 400


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + "".join(LINES[13 * at % 400] for at in range(400)), "as in 12 of 400 rows: it is no time"),
        (HEAD + "".join(LINES[:9]) + "angle [rad],time [s],torque [N*m]\n" + LINES[0], "headings stand there again"),
        (HEAD + "".join(LINES).replace(",", " Nm,"), "cells that are numbers: write units in the headings only"),
        (HEAD + "".join(f"{at},{line}" for at, line in enumerate(LINES)), "4 fields, but the header names 3"),
        (HEAD + '0,"(0.5, 0.1)",0.2\n1,"(0.6, 0.1)",0.3\n', "it is a list whose order no heading names"),
        (" (2024-05-01 10:00:00.004)  can0  201   [2]  0A FF\n", "is a log of CAN frames"),
        ("timestamp,arbitration_id,dlc,data\n0.5,0x201,2,0aff12\n", "is a log of CAN frames"),
        ("header:\n  stamp:\n    sec: 1\neffort:\n- 0.5\n---\n", "is the output of ros2 topic echo"),
        (">tau:1714557600000:0.5§Nm|g\n", "is lines of Teleplot"),
        ("arm,name=f tau=0.5,q=0.1 1714557600000000000\n", "is InfluxDB's line protocol"),
    ],
)
def test_a_log_that_cannot_be_read_is_refused_with_its_own_cause(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(WrongUse, match=re.escape(said)):
        import_table(tmp_path / "a.csv", tmp_path / "a.h5", NAMED, [])


@pytest.mark.parametrize(
    ("cells", "value"),
    [
        (('"1,004.80"', '"998.20"', '"1,004"'), [1.0048, 0.9982, 1.004]),
        (('"1.004,80"', '"998,20"', '"1.004"'), [1.0048, 0.9982, 1.004]),
        (('"1 004,8"', '"998,2"', "1004"), [1.0048, 0.9982, 1.004]),
        (("1'004.8", "\u2212998.2", "n/a"), [1.0048, -0.9982, math.nan]),
    ],
)
def test_thousands_are_read_where_other_numbers_make_them_certain(
    tmp_path: Path, cells: tuple[str, ...], value: list[float]
) -> None:
    rows = "".join(f"{at};{at};{cell};1\n" for at, cell in enumerate(cells))
    with imported(tmp_path, "TIME;POS;TAU;run\n" + rows) as recording:
        np.testing.assert_allclose(recording.channel("torque"), value)


def test_headings_in_another_encoding_are_found_by_the_names_that_are_asked_for(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes("\u6642\u523b [s],\u89d2\u5ea6 [deg],TAU [N*m]\n0,1,2\n1,3,4\n".encode("cp932"))
    assert open_table(tmp_path / "a.csv").titles[1] == "\u89d2\u5ea6 [deg]"  # a word that headings have
    columns = {"time": Column("\u6642\u523b"), "dtheta": Column("\u89d2\u5ea6"), "torque": Column("TAU")}
    assert import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, []).units["dtheta"] == "deg"


def test_the_text_of_windows_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes("Prüfer;x\nTIME [s];POS [°];TAU [mN·m]\n0;1;2\n1;3;4\n".encode("cp1252"))
    import_table(tmp_path / "a.csv", tmp_path / "a.h5", BARE, [])
    (tmp_path / "b.csv").write_bytes(bytes(range(256)))
    with pytest.raises(WrongUse, match="is no text"):
        import_table(tmp_path / "b.csv", tmp_path / "b.h5", BARE, [])


def test_a_row_below_lines_of_comment_is_named_by_its_line_in_the_file(tmp_path: Path) -> None:
    with pytest.raises(WrongUse, match=r"row 5, column tau .mNm.: 'twenty' is not a number"):
        imported(tmp_path, "# a\n\nt [s],tau [mNm],q [rad]\n" + ROWS.replace("20", "twenty"), (), **UNITED)


def test_a_line_without_a_number_below_the_headings_is_no_row(tmp_path: Path) -> None:
    with imported(tmp_path, "TIME,POS,TAU\nfloat,float,float\n" + ROWS) as recording:
        np.testing.assert_allclose(recording.channel("torque"), [1e-4, 2e-4, 3e-4])


STAND = "[stand]\n[limits]\ntorque = 0.03\ndeflection = 1.0\nvelocity = 100.0\n"


@pytest.mark.parametrize(
    ("channel", "column", "unit", "said"),
    [
        (
            "torque",
            "TAU",
            "N*m",
            r"torque swings by \+/- 10 N m, 333 times .* 0.03 N m\..*likely in mN\*m.*--torque-unit mN",
        ),
        (
            "dtheta",
            "TAU",
            "rad",
            r"deflection swings by \+/- 10 rad, 10 times .* 1 rad\..*likely in deg.*--dtheta-unit deg",
        ),
    ],
)
def test_readings_that_a_stand_cannot_make_are_refused_with_the_likely_unit(
    tmp_path: Path, channel: str, column: str, unit: str, said: str
) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    columns = PLAIN | {"torque": Column("run", "mN*m"), channel: Column(column, unit)}
    with pytest.raises(WrongUse, match=said):
        import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [], stand=parse(STAND))
    assert not (tmp_path / "a.h5").exists()


def test_readings_a_little_beyond_a_limit_are_imported_with_a_warning(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    done = import_table(tmp_path / "a.csv", tmp_path / "a.h5", PLAIN, [], stand=parse(STAND))
    assert [one.code for one in done.diagnostics] == ["wrong-unit"]  # 0.375 rev is 2.4 rad
    assert done.ranges == "torque 10 to 30 mN m; deflection -1.57 to 3.14 rad, a span of 270 deg"


def test_failed_reads_are_not_judged_by_the_limits(tmp_path: Path) -> None:
    rows = (
        f"{t / 100},{0.1 * math.sin(t / 30)},{-1.0 if t in (90, 170) else 0.02 * math.sin(t / 30)}" for t in range(300)
    )
    (tmp_path / "a.csv").write_text("t [s],q [rad],tau [N*m]\n" + "\n".join(rows))
    columns = {"time": Column("t"), "dtheta": Column("q"), "torque": Column("tau")}
    assert not import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [], stand=parse(STAND)).diagnostics


def test_a_deflection_of_many_turns_is_warned_of_without_a_stand(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    columns = PLAIN | {"torque": Column("POS", "N*m"), "dtheta": Column("TAU", "rad")}
    done = import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [])
    assert [one.code for one in done.diagnostics] == ["wrong-unit"]
    assert done.ranges.endswith("deflection 10 to 30 rad, a span of 3.18 turns")


@pytest.mark.parametrize("channels", [{"torque"}, {"dtheta"}, {"motor_torque"}, {"motor_torque", "motor_position"}])
def test_half_a_set_of_columns_is_refused(tmp_path: Path, channels: set[str]) -> None:
    source = tmp_path / "a.csv"
    source.write_text(TABLE)
    columns = {"time": Column("TIME", "s")} | {channel: Column("POS", "rad") for channel in channels}
    with pytest.raises(WrongUse, match="--"):
        import_table(source, tmp_path / "a.h5", columns, [])


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("none.csv", None, "cannot be read"),
        ("bad.csv.gz", b"not gzip", "cannot be read"),
        ("..", None, "is not a file"),
        ("a.mat", b"MATLAB 7.3 MAT-file", "is damaged"),
        ("a.mat", b"junk" * 64, "is damaged, or not what"),
        ("a.mat", b"", "is empty"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path, name: str, content: bytes | None, said: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(WrongUse, match=said):
        import_table(tmp_path / name, tmp_path / "a.h5", PLAIN, [])


# --- MATLAB and Parquet ----------------------------------------------------------------------------------------------


def test_vectors_of_a_matlab_file_are_columns_a_structs_too(tmp_path: Path) -> None:
    from scipy.io import savemat

    time = np.array([0.5, 0.6, 0.7])
    log = {"pos": np.array([[0.25, 0.5, -0.25]]), "tau": np.array([[10.0], [20.0], [30.0]])}
    savemat(tmp_path / "a.mat", {"t": time, "run": np.array([1, 1, 2]), "log": log, "name": "a run"})
    columns = {"time": Column("t", "s"), "torque": Column("log.tau", "mN*m"), "dtheta": Column("log.pos", "rev")}
    import_table(tmp_path / "a.mat", tmp_path / "a.h5", columns, [RowFilter.parse("run==1")])
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("torque"), [0.01, 0.02])
        np.testing.assert_allclose(recording.channel("dtheta"), [0.5 * math.pi, math.pi])


def test_columns_of_unequal_length_are_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"TIME": np.arange(3.0), "TAU": np.arange(4.0), "POS": np.arange(3.0)})
    with pytest.raises(WrongUse, match="unequal length \\(TIME 3, TAU 4, POS 3\\)"):
        import_table(tmp_path / "a.mat", tmp_path / "a.h5", PLAIN, [])


def test_a_parquet_file_reads_as_the_same_table_in_csv(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="PARQUET NOT TESTED: pyarrow is missing")
    from pyarrow.parquet import write_table

    table = {"TIME": [0.5, 0.6, 0.7], "POS": [0.25, 0.5, None], "TAU": [10, 20, 30], "run": [1, 1, 2], "s": ["a"] * 3}
    write_table(pyarrow.table(table), tmp_path / "a.parquet")
    assert import_table(tmp_path / "a.parquet", tmp_path / "a.h5", PLAIN, [RowFilter.parse("run>0")]).samples == 3
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("torque"), [0.01, 0.02, 0.03])
        np.testing.assert_allclose(recording.channel("dtheta") / math.pi, [0.5, 1.0, math.nan])
    with pytest.raises(WrongUse, match="column 's' does not hold numbers"):
        import_table(tmp_path / "a.parquet", tmp_path / "b.h5", PLAIN | {"torque": Column("s", "N*m")}, [])
    (tmp_path / "b.parquet").write_bytes(b"junk")
    with pytest.raises(WrongUse, match="is damaged, or not what its name says"):
        import_table(tmp_path / "b.parquet", tmp_path / "b.h5", PLAIN, [])


def test_parquet_without_its_library_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(WrongUse, match="is Parquet or Arrow: pip install 'hil\\[parquet\\]', or save it as CSV"):
        import_table(tmp_path / "a.parquet", tmp_path / "a.h5", PLAIN, [])


DRIVEN = "TIME,POS,TAU,u\n" + "".join(f"{i / 10},{math.sin(i)},{math.cos(i)},{i % 3}\n" for i in range(10))


@pytest.mark.parametrize(
    ("heading", "unit", "si", "factor"),
    [
        ("u [mN*m]", None, "N*m", 1e-3),
        ("u_deg", None, "rad", math.pi / 180.0),
        ("u", "mA", "A", 1e-3),
        ("u (V)", "V", "V", 1.0),
    ],
)
def test_a_command_is_of_the_dimension_that_its_unit_says(
    tmp_path: Path, heading: str, unit: str | None, si: str, factor: float
) -> None:
    command = Column("u", unit, -2.0)
    with imported(tmp_path, DRIVEN.replace(",u\n", f",{heading}\n"), command=command) as recording:
        np.testing.assert_allclose(recording.channel("command"), -2.0 * factor * (np.arange(10) % 3))
    assert load(tmp_path / "a.h5").units["command"] == si


def test_a_set_point_holds_until_the_next(tmp_path: Path) -> None:
    text = "TIME,POS,TAU,u\n0,1,1,\n1,2,3,5\n2,3,1,\n3,1,2,7\n4,2,2,\n"
    with imported(tmp_path, text, command=Column("u", "A")) as recording:
        np.testing.assert_array_equal(recording.channel("command"), [math.nan, 5.0, 5.0, 7.0, 7.0])


@pytest.mark.parametrize(
    ("text", "column", "said"),
    [
        (DRIVEN, Column("u"), "'u' does not say whether the command is a torque, an angle, a current or a voltage"),
        (
            DRIVEN,
            Column("u", "kg"),
            "--command-unit kg: kg is not a unit of a torque, an angle, a current or a voltage",
        ),
        (DRIVEN.replace(",u\n", ",u [deg]\n"), Column("u", "V"), "'u [deg]' is an angle by its heading"),
        (re.sub(r",[012]\n", ",4\n", DRIVEN), Column("u", "A"), "'u' is 4 in every row: leave --command out"),
        (re.sub(r",[012]\n", ",nan\n", DRIVEN), Column("u", "A"), "'u' holds no number"),
        (re.sub(r",[012]\n", ",inf\n", DRIVEN), Column("u", "A"), "'u' holds no number"),
        (DRIVEN, Column("POS", "A", -3.0), "'POS' is the dtheta that was read, whose errors it shares"),
        (DRIVEN, Column("TAU", "V"), "'TAU' is the torque that was read, whose errors it shares"),
    ],
)
def test_a_command_that_is_none_is_refused_with_a_reason(tmp_path: Path, text: str, column: Column, said: str) -> None:
    with pytest.raises(WrongUse, match=re.escape(said)):
        imported(tmp_path, text, command=column)


def test_an_index_beside_a_column_of_names_is_read_only_for_a_named_joint(tmp_path: Path) -> None:
    rows = (f"{k},{('finger', 'thumb')[k % 2]},{k},0.{k}\n" for k in range(8))
    (tmp_path / "a.csv").write_text("%time,field.name0,field.effort0,field.position0\n" + "".join(rows))
    columns = {
        "time": Column("%time", "ns"),
        "torque": Column("field.effort0", "N*m"),
        "dtheta": Column("field.position0", "rad"),
    }
    with pytest.raises(WrongUse, match=r"the order of joints changes .* --where field\.name0==JOINT"):
        import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [])
    import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [RowFilter.parse("field.name0==thumb")])
    with Recording(tmp_path / "a.h5") as recording:
        assert recording.channel("torque").tolist() == [1.0, 3.0, 5.0, 7.0]


@pytest.mark.parametrize(("beside", "error"), [("q2,tau2", [True]), ("q_pip,tau_pip", [True]), ("q1_cmd,tau1_cmd", [])])
def test_a_joint_that_moved_too_is_an_error_a_set_point_is_not(tmp_path: Path, beside: str, error: list[bool]) -> None:
    rows = "".join(f"{t},{math.sin(t)},{math.sin(t)},{0.9 * math.sin(t - 0.1)},0\n" for t in range(50))
    torque, dtheta, table = Column("tau1", "N*m"), Column("q1", "rad"), f"TIME,q1,tau1,{beside}\n{rows}"
    with imported(tmp_path, table, torque=torque, dtheta=dtheta), open_sources([tmp_path / "a.h5"]) as sources:
        assert [one.is_error for one in other_joints_diagnostics(sources)] == error
