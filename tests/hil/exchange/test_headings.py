"""Headings: where people write a unit, and what the column is then called."""

from __future__ import annotations

import pytest

from hil.errors import WrongUse
from hil.exchange.headings import names, unit_of


@pytest.mark.parametrize(
    ("title", "dimension", "name", "unit"),
    [
        ("torque [mN m]", "torque", "torque", "mN m"),
        ("torque(N·m)", "torque", "torque", "N·m"),
        ("torque {mNm}", "torque", "torque", "mNm"),
        ("torque_mNm", "torque", "torque", "mNm"),
        ("torque_mnm", "torque", "torque", "mnm"),
        ("torque.mNm", "torque", "torque", "mNm"),
        ("effort-mNm", "torque", "effort", "mNm"),
        ("effort_mN_m", "torque", "effort", "mN_m"),
        ("Torque, N m", "torque", "Torque", "N m"),
        ("torque in mNm", "torque", "torque", "mNm"),
        ("torqueNm", "torque", "torque", "Nm"),
        ("torquemNm", "torque", "torque", "mNm"),
        ("tau_Nm (filtered)", "torque", "tau_Nm", "Nm"),
        ("torque [mN m] of the cell", "torque", "torque  of the cell", "mN m"),
        ("angle (deg)", "angle", "angle", "deg"),
        ("dtheta/rad", "angle", "dtheta", "rad"),
        ("angleDeg", "angle", "angle", "Deg"),
        ("ANGLE_DEG", "angle", "ANGLE", "DEG"),
        ("theta [°]", "angle", "theta", "°"),
        ("velocity_rad_s", "rate", "velocity", "rad_s"),
        ("velocity_rad_per_s", "rate", "velocity", "rad_per_s"),
        ("omega/(rad/s)", "rate", "omega", "rad/s"),
        ("dtheta_dot/rad/s", "rate", "dtheta_dot", "rad/s"),
        ("time_ms", "time", "time", "ms"),
        ("timeMs", "time", "time", "ms"),
        ("t [s]", "time", "t", "s"),
        ("timestamp_ns", "time", "timestamp", "ns"),
    ],
)
def test_a_unit_is_found_wherever_a_heading_has_it(title: str, dimension: str, name: str, unit: str) -> None:
    assert unit_of(title, dimension) == unit
    assert name in names(title)


@pytest.mark.parametrize("title", ["seconds", "time_s", "s"])
def test_a_heading_may_be_a_unit_alone(title: str) -> None:
    assert unit_of(title, "time") is not None


@pytest.mark.parametrize(
    ("title", "dimension"),
    [
        ("tau", "torque"),
        ("tau (filtered)", "torque"),
        ("tau [V]", "torque"),
        ("motor_torque", "torque"),
        ("taumNm", "torque"),  # tau in mN m, or taum in N m?
        ("pos_rad_s", "angle"),
        ("/joint_states/finger/position", "angle"),
        ("t", "time"),
        ("timestamp", "time"),
    ],
)
def test_what_is_no_certain_unit_is_none(title: str, dimension: str) -> None:
    assert unit_of(title, dimension) is None


@pytest.mark.parametrize(
    ("title", "dimension", "said"),
    [
        ("tau_Nm [mNm]", "torque", "two units, mNm and Nm"),
        ("tau [deg]", "torque", "an angle by its heading, not a torque"),
    ],
)
def test_a_heading_that_contradicts_itself_or_the_channel_is_refused(title: str, dimension: str, said: str) -> None:
    with pytest.raises(WrongUse, match=said):
        unit_of(title, dimension)
