"""CSV into recordings: units, filters, and a sentence with the row for everything that is wrong."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from hil.errors import WrongUse
from hil.importer import Column, Condition, import_csv
from hil.stand import parse
from hil.store import Recording

TABLE = "TIME,POS,TAU,run\n0.5,0.25,10,1\n0.6,0.5,20,1\n0.7,-0.25,30,2\n"
PLAIN = {"time": Column("TIME", "s"), "torque": Column("TAU", "mN*m"), "dtheta": Column("POS", "rev")}


def imported(tmp_path: Path, text: str, where: tuple[str, ...] = (), **columns: Column) -> Recording:
    source = tmp_path / "a.csv"
    source.write_bytes(text.encode())
    import_csv(source, tmp_path / "a.h5", PLAIN | columns, [Condition.parse(item) for item in where])
    return Recording(tmp_path / "a.h5")


def test_columns_arrive_in_si_and_time_starts_at_zero(tmp_path: Path) -> None:
    with imported(tmp_path, TABLE) as recording:
        np.testing.assert_allclose(recording.channel("time"), [0.0, 0.1, 0.2])
        np.testing.assert_allclose(recording.channel("torque"), [0.01, 0.02, 0.03])
        np.testing.assert_allclose(recording.channel("dtheta"), np.array([0.5, 1.0, -0.5]) * math.pi)
        assert np.isnan(recording.channel("dtheta_dot")).all()
        assert recording.profile == {"kind": "imported", "source": "a.csv", "where": ""}


@pytest.mark.parametrize(
    ("where", "kept"),
    [
        (("run==1",), [10.0, 20.0]),
        (("run != 1",), [30.0]),
        (("TAU>=20", "TAU<30"), [20.0]),
        (("POS>0.3",), [20.0]),
        (("POS<=-0.25",), [30.0]),
    ],
)
def test_only_rows_that_meet_every_condition_are_kept(
    tmp_path: Path, where: tuple[str, ...], kept: list[float]
) -> None:
    with imported(tmp_path, TABLE, where) as recording:
        np.testing.assert_allclose(recording.channel("torque") * 1e3, kept)


def test_a_gzipped_file_with_a_byte_order_mark_and_crlf_reads_the_same(tmp_path: Path) -> None:
    source = tmp_path / "a.csv.gz"
    source.write_bytes(gzip.compress(b"\xef\xbb\xbf" + TABLE.replace("\n", "\r\n").encode()))
    assert import_csv(source, tmp_path / "b.h5", PLAIN, []) == 3


def test_semicolons_separate_too(tmp_path: Path) -> None:
    with imported(tmp_path, TABLE.replace(",", ";")) as recording:
        assert len(recording) == 3


def test_an_empty_cell_is_a_nan(tmp_path: Path) -> None:
    with imported(tmp_path, TABLE.replace("0.6,0.5,20", "0.6,0.5,")) as recording:
        assert np.isnan(recording.channel("torque")).tolist() == [False, True, False]


def test_motor_columns_come_to_the_joint_through_the_stands_gear(tmp_path: Path) -> None:
    source = tmp_path / "a.csv"
    source.write_text("t,p,q\n0,8.0,0.001\n0.1,8.4,0.002\n")
    columns = {"time": Column("t", "s"), "motor_torque": Column("q", "N*m"), "motor_position": Column("p", "rad")}
    stand = parse("[stand]\ngear_ratio = 4.0\n")
    import_csv(source, tmp_path / "a.h5", columns, [], stand=stand)
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("torque"), [0.004, 0.008])
        np.testing.assert_allclose(recording.channel("dtheta"), [0.0, 0.1])
        np.testing.assert_allclose(recording.channel("motor_position"), [8.0, 8.4])
        assert recording.stand_toml == "[stand]\ngear_ratio = 4.0\n"


@pytest.mark.parametrize(
    ("text", "where", "said"),
    [
        (TABLE.replace("TAU", "tau"), (), "no column 'TAU'; it has TIME, POS, tau, run"),
        (TABLE.replace("run", "TAU"), (), "2 columns named 'TAU'"),
        (TABLE.replace("20", "twenty"), (), "row 3, column TAU: 'twenty' is not a number"),
        (TABLE.replace(",", ";").replace("0.5;20", "0,5;20"), (), "decimals with a point"),
        (TABLE + "1.0,2\n", (), "row 5: 2 fields, but the header names 4"),
        (TABLE.replace("0.7", "0.1"), (), "row 4: the time goes backwards"),
        (TABLE.replace("0.7", ""), (), "row 4: the time is not a number"),
        (TABLE, ("run==9",), "no row meets run==9"),
        (TABLE, ("speed==9",), "no column 'speed'"),
        (TABLE, ("run=1",), "write a column, one of"),
        (TABLE, ("run==one",), "write a column, one of"),
        ("TIME,POS,TAU\n", (), "no rows"),
        ("", (), "no column"),
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
        imported(tmp_path, TABLE, torque=Column("TAU", "mNm"))


@pytest.mark.parametrize(
    ("unit", "dimension", "si"),
    [
        ("kgf*cm", "torque", 0.0980665),
        ("gf*cm", "torque", 9.80665e-5),
        ("ozf*in", "torque", 0.00706155),
        ("deg", "angle", 0.01745329),
        ("rpm", "rate", 0.10471976),
        ("us", "time", 1e-6),
    ],
)
def test_units_are_what_the_tables_of_physics_say(unit: str, dimension: str, si: float) -> None:
    from hil.units import factor

    assert factor(dimension, unit) == pytest.approx(si, rel=1e-6)


@pytest.mark.parametrize("channels", [{"torque"}, {"dtheta"}, {"motor_torque"}, {"motor_torque", "motor_position"}])
def test_half_a_set_of_columns_is_refused(tmp_path: Path, channels: set[str]) -> None:
    source = tmp_path / "a.csv"
    source.write_text(TABLE)
    columns = {"time": Column("TIME", "s")} | {channel: Column("POS", "rad") for channel in channels}
    with pytest.raises(WrongUse, match="--"):
        import_csv(source, tmp_path / "a.h5", columns, [])


@pytest.mark.parametrize("name", ["none.csv", "bad.csv.gz", "latin.csv"])
def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "bad.csv.gz").write_bytes(b"not gzip")
    (tmp_path / "latin.csv").write_bytes(b"TIME,POS,TAU\n0,\xe9,1\n")
    with pytest.raises(WrongUse, match="cannot be read"):
        import_csv(tmp_path / name, tmp_path / "a.h5", PLAIN, [])
