"""A deflection as a difference of columns, each in its own unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.errors import WrongUse
from hil.exchange.importer import Column, import_table
from hil.recording.reader import Recording

TIME = np.arange(40) / 100.0
ANGLE = 0.2 * np.sin(5.0 * TIME)
STATED = "t [s],tau [N*m],motor [deg],joint [rad]"
BARE = "t [s],tau [N*m],motor pos,joint"


def deflection(tmp_path: Path, headings: str, text: str, unit: str | None = None) -> np.ndarray:
    """Import a table in which the motor's angle is 20 times that of the deflection and the joint together."""
    table = np.column_stack([TIME, 0.5 * ANGLE, 20.0 * np.degrees(ANGLE + 0.7), np.full_like(TIME, 0.7)])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=headings, comments="")
    columns = {"time": Column("t"), "torque": Column("tau"), "dtheta": Column(text, unit)}
    done = import_table(tmp_path / "a.csv", tmp_path / "a.h5", columns, [], force=True)
    assert done.units["dtheta"] == "rad"
    with Recording(tmp_path / "a.h5") as recording:
        return recording.channel("dtheta")


@pytest.mark.parametrize(
    ("headings", "text", "unit"),
    [
        (STATED, "motor/20 - joint", None),
        (STATED, "motor [deg]/20 - joint [rad]", None),
        (STATED, "-(joint + -0.05*motor)", None),
        (STATED.replace(" [deg]", "_deg"), "motor_deg/(2*1e1) - joint", None),
        (BARE, "'motor pos'[deg]/20 - joint[rad]", None),
        (BARE, "'motor pos'[deg]/20 - joint", "rad"),
    ],
)
def test_a_sum_of_columns_is_read_with_the_unit_of_each(
    tmp_path: Path, headings: str, text: str, unit: str | None
) -> None:
    np.testing.assert_allclose(deflection(tmp_path, headings, text, unit), ANGLE, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("motor/20 - jonit", r"has no column 'jonit'; .*it has t \[s\], tau"),
        ("motor/20 -", "For a sum of columns write names"),
        ("motor/0 - joint", r"divides by zero \(motor/0\)"),
        ("motor/(1 - 1)", "divides by zero"),
        ("motor/joint", "divides by a column"),
        ("motor*joint", "multiplies two columns"),
        ("motor/20 - 0.7", "adds a number without a unit"),
        ("2*3", "is not a sum of columns"),
        ("1e308*10*motor", "finite factors"),
        ("motor**2", "cannot stand in a sum"),
        ("motor if joint else tau", "cannot stand in a sum"),
        ("__import__('os').getcwd()", "has no column"),
        ("motor+" * 2000, "has 12000 characters, more than 300"),
        ("(" * 250 + "motor" + ")" * 45, "has no column"),
        ("motor[N*m] - joint", r"unknown unit of angle 'N\*m'"),
        ("motor[rad]/20 - joint", "is in deg by its heading and in rad by the option"),
    ],
)
def test_what_is_no_sum_of_columns_is_refused_and_never_run(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(WrongUse, match=said):
        deflection(tmp_path, STATED, text)


def test_a_column_of_a_sum_without_a_unit_is_refused_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(
        WrongUse, match=r"the unit of 'joint' \(0.7 to 0.7\): write it behind the name, such as joint\[rad\], or"
    ):
        deflection(tmp_path, BARE, "'motor pos'[deg]/20 - joint")
