"""Two tables of one file, at two rates, are joined: groups, topics, labels of rows, columns side by side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hil.errors import WrongUse
from hil.exchange.importer import Column, import_table
from hil.exchange.join import Join
from hil.recording.reader import Recording

FAST, SLOW = np.arange(1000) / 500.0, np.arange(400) / 200.0 + 0.0007
TORQUE, ANGLE = 0.1 * np.sin(9.0 * FAST), 0.2 * np.cos(11.0 * SLOW)


def groups(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for group, time, name, values, unit in (
            ("cell", FAST, "tau", TORQUE, "N*m"),
            ("drive/encoder", SLOW, "q", ANGLE, "rad"),
        ):
            file[f"{group}/stamp"], file[f"{group}/{name}"] = time, values
            file[f"{group}/stamp"].attrs["unit"], file[f"{group}/{name}"].attrs["unit"] = "s", unit


def arrays(path: Path) -> None:
    np.savez(path, t_cell=FAST, tau=TORQUE, t_drive=SLOW, q=ANGLE)


def long_rows() -> list[tuple[float, str, float]]:
    both = [(t, "tau", x) for t, x in zip(FAST, TORQUE, strict=True)]
    return sorted([*both, *((t, "q", x) for t, x in zip(SLOW, ANGLE, strict=True))])


def long_csv(path: Path) -> None:
    path.write_text("t [s],signal,value\n" + "".join(f"{t:.6f},{name},{x:.9f}\n" for t, name, x in long_rows()))


def in_blocks(path: Path) -> None:
    rows = sorted(long_rows(), key=lambda row: row[1], reverse=True)
    path.write_text("t [s],signal,value\n" + "".join(f"{t:.6f},{name},{x:.9f}\n" for t, name, x in rows))


def long_lines(path: Path) -> None:
    path.write_text("".join(json.dumps({"t": t, "signal": name, "value": x}) + "\n" for t, name, x in long_rows()))


def beside(path: Path) -> None:
    slow = [f"{t:.6f},{x:.9f}" for t, x in zip(SLOW, ANGLE, strict=True)] + [","] * (len(FAST) - len(SLOW))
    rows = [f"{t:.6f},{x:.9f},{more}\n" for t, x, more in zip(FAST, TORQUE, slow, strict=True)]
    path.write_text("t1 [s],tau [N*m],t2 [s],q [rad]\n" + "".join(rows))


def in_turn(path: Path) -> None:
    rows = [f"{t:.6f},{x:.9f},\n" if name == "tau" else f"{t:.6f},NaN,{x:.9f}\n" for t, name, x in long_rows()]
    path.write_text("t [s],tau [N*m],q [rad]\n" + "".join(rows))


def equal_groups(path: Path) -> None:
    with h5py.File(path, "w") as file:
        early = SLOW - 2e-3
        file["cell/time"], file["cell/tau"] = early, 0.1 * np.sin(9.0 * early)
        file["drive/time"], file["drive/q"] = SLOW, ANGLE


def read(path: Path, time: str, torque: str, dtheta: str, join: str | None = None) -> str:
    columns = {"time": Column(time, "s"), "torque": Column(torque, "N*m"), "dtheta": Column(dtheta, "rad")}
    second = None if join is None else Join(path, join)
    return import_table(path, path.with_name("made.h5"), columns, [], join=second, force=True).said


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("a.h5", groups, ("cell/stamp", "cell/tau", "drive/encoder/q")),
        ("a.h5", groups, ("cell:stamp", "cell:tau", "drive/encoder:q")),
        ("a.h5", groups, ("cell/stamp", "cell/tau", "drive/encoder/q", "drive/encoder/stamp")),
        ("a.npz", arrays, ("t_cell", "tau", "q", "t_drive")),
        ("a.csv", long_csv, ("t", "tau:value", "q:value")),
        ("a.csv", in_blocks, ("t", "tau:value", "q:value")),
        ("a.jsonl", long_lines, ("t", "tau:value", "q:value")),
        ("a.csv", beside, ("t1", "tau", "q", "t2")),
        ("a.csv", beside, ("t1", "tau", "q")),
        ("a.csv", in_turn, ("t", "tau", "q")),
    ],
)
def test_torque_and_angle_of_two_tables_are_joined_on_one_clock(
    tmp_path: Path, name: str, make: Any, words: tuple[str, ...]
) -> None:
    make(tmp_path / name)
    assert "one clock" in read(tmp_path / name, *words)
    with Recording(tmp_path / "made.h5") as recording:
        torque, angle = recording.channel("torque"), recording.channel("dtheta")
    assert len(angle) in {399, 400}
    np.testing.assert_allclose(angle, ANGLE[: len(angle)], atol=1e-5)
    np.testing.assert_allclose(torque, 0.1 * np.sin(9.0 * SLOW[: len(angle)]), atol=1e-5)


def test_groups_of_one_rate_whose_clocks_are_apart_are_no_rows_of_one_table(tmp_path: Path) -> None:
    equal_groups(tmp_path / "a.h5")
    assert "one clock" in read(tmp_path / "a.h5", "cell/time", "cell/tau", "drive/q")
    with Recording(tmp_path / "made.h5") as recording:
        time = SLOW[1] - 2e-3 + recording.channel("time")  # from the cell's first that lies within the drive's
        torque, angle = recording.channel("torque"), recording.channel("dtheta")
    np.testing.assert_allclose(torque, 0.1 * np.sin(9.0 * time), atol=1e-8)
    np.testing.assert_allclose(angle, 0.2 * np.cos(11.0 * time), atol=1e-4)  # it is read between its rows


@pytest.mark.parametrize(
    ("name", "make", "words", "said"),
    [
        ("a.npz", arrays, ("t_cell", "tau", "q"), "several tables.*|not clear, .*--join-time NAME"),
        ("a.csv", long_csv, ("t", "value", "value"), "both 'value'.*'signal'.*q:COLUMN"),
        ("a.csv", long_csv, ("t", "tau", "q:value"), "'tau' is no column, but a text in the column 'signal'.*tau:COL"),
        ("a.h5", groups, ("cell/stamp", "cell/tau", "cell/q"), "no column 'cell/q'"),
    ],
)
def test_what_is_not_clear_of_the_tables_is_refused_with_the_words_to_write(
    tmp_path: Path, name: str, make: Any, words: tuple[str, ...], said: str
) -> None:
    make(tmp_path / name)
    with pytest.raises(WrongUse, match=said):
        read(tmp_path / name, *words)
