"""Two files of one run, on one clock or on clocks that differ by a constant; and the rows between two times."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.errors import WrongUse
from hil.exchange.importer import Column, Imported, import_table
from hil.exchange.join import Join
from hil.identification.same_stand import other_joints_diagnostics
from hil.recording.reader import Recording
from hil.signals.source import open_sources
from hil.stand.file import parse

STIFFNESS, DAMPING = 0.5, 0.004
RATES = np.array([0.4, 1.1, 2.3, 3.7, 5.2]) * 2.0 * np.pi  # rad/s
PHASES = np.array([0.0, 2.0, 5.0, 1.0, 4.0])


def motion(time: Any) -> tuple[Any, Any]:
    waves = np.outer(time, RATES) + PHASES
    return 0.05 * np.sin(waves).sum(axis=1), 0.05 * (RATES * np.cos(waves)).sum(axis=1)


def logged(
    folder: Path, late: float = 0.0, *, drive: str = "t [s],angle [deg]", cell: str = "t [ms],tau [mN*m]"
) -> None:
    """Write the drive's log at 250 Hz and the cell's at 400 Hz, whose clock is behind; 2 % of the rows are lost."""
    rng = np.random.default_rng(5)
    for name, rate, heading in (("drive.csv", 250.0, drive), ("cell.csv", 400.0, cell)):
        time = np.sort(np.arange(0.0, 8.0, 1.0 / rate) + rng.uniform(0.0, 0.5 / rate, int(8.0 * rate)))
        time = time[rng.random(len(time)) > 0.02]
        angle, speed = motion(time)
        torque = STIFFNESS * angle + DAMPING * speed + rng.normal(0.0, 2e-4, len(time))
        columns = [time, np.degrees(angle)] if name == "drive.csv" else [1e3 * (time - late), 1e3 * torque]
        np.savetxt(folder / name, np.column_stack(columns), "%.14g", ",", header=heading, comments="")


def joined(folder: Path, columns: Mapping[str, str], join: Join, **more: Any) -> Imported:
    named = {channel: Column(name) for channel, name in columns.items()}
    return import_table(folder / "drive.csv", folder / "a.h5", named, [], join=join, force=True, **more)


def test_other_joints_of_two_files_are_compared(tmp_path: Path) -> None:
    logged(tmp_path, drive="t [s],angle1 [deg]", cell="t [ms],tau1 [mN*m]")
    for name, added in (("drive.csv", ",angle2 [deg]"), ("cell.csv", ",tau2 [mN*m]")):
        first, *rows = (tmp_path / name).read_text().splitlines()
        lines = [first + added, *(f"{row},{0.5 * float(row.split(',')[1])}" for row in rows)]
        (tmp_path / name).write_text("\n".join(lines))
    named = {"time": "t", "torque": "tau1", "dtheta": "angle1"}
    joined(tmp_path, named, Join(tmp_path / "cell.csv", "t", shared=True))
    with open_sources([tmp_path / "a.h5"]) as sources:
        (found,) = other_joints_diagnostics(sources)
    assert found.is_error
    assert "angle2 [deg] moved too" in found.message


PLAIN = {"time": "t", "torque": "tau", "dtheta": "angle"}


def coefficients(folder: Path) -> Any:
    """Return Kc and Bc by least squares, with the true rate at the times of the recording."""
    with Recording(folder / "a.h5") as recording:
        torque, angle = recording.channel("torque"), recording.channel("dtheta")
        time = recording.channel("time")
    rate = np.gradient(angle, time)
    good = np.isfinite(torque) & np.isfinite(rate)
    return np.linalg.lstsq(np.column_stack([angle, rate])[good], torque[good], rcond=None)[0]


@pytest.mark.parametrize(("late", "shared"), [pytest.param(0.0, True, marks=pytest.mark.study), (-1.7e9, False)])
def test_two_files_give_kc_and_bc_on_one_clock_and_on_clocks_that_differ(
    tmp_path: Path, late: float, *, shared: bool
) -> None:
    logged(tmp_path, late)
    done = joined(tmp_path, PLAIN, Join(tmp_path / "cell.csv", None, shared))
    assert done.units == {"time": "s", "torque": "mN*m", "dtheta": "deg"}
    np.testing.assert_allclose(coefficients(tmp_path), [STIFFNESS, DAMPING], rtol=0.02)
    shift = re.search(r"cell\.csv are shifted by (\S+) s", done.said)
    assert shared if shift is None else float(shift[1]) == pytest.approx(late, rel=0.0, abs=2e-4)


def test_a_column_that_both_files_have_is_named_with_its_file(tmp_path: Path) -> None:
    logged(tmp_path, drive="t [s],value [deg]", cell="at [ms],value [mN*m]")
    with pytest.raises(WrongUse, match=r"both have 'value': write cell\.csv:value, or drive\.csv:value"):
        joined(tmp_path, PLAIN | {"torque": "value", "dtheta": "value"}, Join(tmp_path / "cell.csv", "at"))
    named = PLAIN | {"torque": "cell.csv:value", "dtheta": "drive.csv:value"}
    joined(tmp_path, named, Join(tmp_path / "cell.csv", "at", shared=True))
    np.testing.assert_allclose(coefficients(tmp_path), [STIFFNESS, DAMPING], rtol=0.02)


@pytest.mark.study
def test_files_that_cannot_be_joined_are_refused_with_the_cause(tmp_path: Path) -> None:
    logged(tmp_path, late=100.0)
    with pytest.raises(
        WrongUse, match=r"drive\.csv is from 0.* to 7\.99.* s, .*cell\.csv from -.*, so they have no common time"
    ):
        joined(tmp_path, PLAIN, Join(tmp_path / "cell.csv", shared=True))
    stand = parse("[stand]\ngear_ratio = 4.0\n")
    with pytest.raises(WrongUse, match="cannot be compared by the torque of a motor"):
        joined(
            tmp_path, {"time": "t", "motor_torque": "tau", "dtheta": "angle"}, Join(tmp_path / "cell.csv"), stand=stand
        )
    rng = np.random.default_rng(2)
    noise = np.column_stack([np.arange(0.0, 8e3, 2.5), np.convolve(rng.normal(size=3200), np.ones(20), "same")])
    np.savetxt(tmp_path / "cell.csv", noise, delimiter=",", header="t [ms],tau [mN*m]", comments="")
    with pytest.raises(WrongUse, match="that of another run"):
        joined(tmp_path, PLAIN, Join(tmp_path / "cell.csv"))


@pytest.mark.study
def test_a_motion_of_one_frequency_does_not_tell_the_clocks_apart(tmp_path: Path) -> None:
    time = np.arange(0.0, 8.0, 0.004)
    sine = np.column_stack([time, np.degrees(0.1 * np.sin(9.0 * time))])
    np.savetxt(tmp_path / "drive.csv", sine, delimiter=",", header="t [s],angle [deg]", comments="")
    noise = np.random.default_rng(1).normal(0.0, 2e-4, len(time))
    cell = np.column_stack([time, 0.05 * np.sin(9.0 * time + 0.1) + noise])
    np.savetxt(tmp_path / "cell.csv", cell, delimiter=",", header="t [s],tau [N*m]", comments="")
    with pytest.raises(WrongUse, match=r"cannot be compared well enough: .* move at several speeds"):
        joined(tmp_path, PLAIN, Join(tmp_path / "cell.csv"))


STAMPED = "2024-05-01 23:59:{:06.3f}", "2024-05-02 00:00:{:06.3f}"


@pytest.mark.parametrize(
    ("form", "first", "last", "kept"),
    [
        ("{:.1f}", "57.95", "61", [58.0, 59.0, 60.0, 61.0]),
        ("{:.1f}", None, "0.95 min", [57.0]),
        (None, "23:59:58.5", "00:00:00.5", [59.0, 60.0]),
        (None, "2024-05-02 00:00:00", None, [60.0, 61.0, 62.0]),
    ],
)
def test_rows_are_chosen_by_the_times_of_the_file(
    tmp_path: Path, form: str | None, first: str | None, last: str | None, kept: list[float]
) -> None:
    lines = [
        f"{form.format(at) if form else STAMPED[int(at >= 60)].format(at % 60.0)},{at},{at}"
        for at in np.arange(57.0, 63.0)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["t [s],tau [N*m],q [rad]" if form else "t,tau [N*m],q [rad]", *lines]))
    columns = {"time": Column("t"), "torque": Column("tau"), "dtheta": Column("q")}
    import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [], between=(first, last))
    with Recording(tmp_path / "a.h5") as recording:
        assert recording.channel("torque").tolist() == kept
    with pytest.raises(
        WrongUse, match=r"no row is between --from and --to, because its times are from (57|2024-05-01 23)"
    ):
        import_table(tmp_path / "a.csv", tmp_path / "b.h5", columns, [], between=("99", "100"))


@pytest.mark.study
def test_a_file_whose_clock_was_set_is_not_joined(tmp_path: Path) -> None:
    logged(tmp_path)
    rows = np.loadtxt(tmp_path / "cell.csv", delimiter=",", skiprows=1)
    rows[1500:, 0] -= 900.0
    np.savetxt(tmp_path / "cell.csv", rows, "%.14g", ",", header="t [ms],tau [mN*m]", comments="")
    with pytest.raises(WrongUse, match=r"cell\.csv: .*the clock was set.* No second file can be joined"):
        joined(tmp_path, PLAIN, Join(tmp_path / "cell.csv", shared=True))


def test_clocks_that_drift_apart_are_named_with_the_factor_that_mends_them(tmp_path: Path) -> None:
    logged(tmp_path, late=0.731)
    cell = np.loadtxt(tmp_path / "cell.csv", delimiter=",", skiprows=1)
    cell[:, 0] *= 1.0 - 400e-6
    np.savetxt(tmp_path / "cell.csv", cell, "%.14g", ",", header="t [ms],tau [mN*m]", comments="")
    with pytest.raises(WrongUse, match=r"drift apart by (3[89]\d|4[01]\d) ppm.*--join-time '1\.000\d+\*NAME'"):
        joined(tmp_path, PLAIN, Join(tmp_path / "cell.csv"))
    joined(tmp_path, PLAIN, Join(tmp_path / "cell.csv", "1.0004*t"))
    np.testing.assert_allclose(coefficients(tmp_path), [STIFFNESS, DAMPING], rtol=0.03)
