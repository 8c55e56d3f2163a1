"""Headings: where people write a unit, and what the column is then called."""

from __future__ import annotations

import math
import random
import re

import pytest

from hil import units
from hil.errors import WrongUse
from hil.exchange.headings import names, unit_of


@pytest.mark.parametrize(
    ("title", "dimension", "name", "unit"),
    [
        ("torque [mN m]", "torque", "torque", "mN m"),
        ("torque(N·m)", "torque", "torque", "N·m"),
        ("torque {mNm}", "torque", "torque", "mNm"),
        ("torque\uff08N\u30fbm\uff09", "torque", "torque", "N\u30fbm"),
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


WORDS = """
    joint knee motor load cell angle torque time position speed rotation turn cycle revolution second
    minute hour degree radian inch foot feet pound ounce gram meter newton min rev in gin inn num chunks
    is as gm ring Rotation Turn QoS filtered left raw target actual mean
""".split()  # noqa: SIM905 - as a list it takes fifty lines
WRITTEN = {
    "time": ("s", "ms", "us", "ns", "sec", "seconds"),
    "torque": ("Nm", "N m", "mNm", "N*mm", "kgf*cm", "oz-in"),
    "angle": ("rad", "deg", "mrad", "degrees", "°"),
    "rate": ("rad/s", "deg/s", "rpm", "rad_s"),
}
MARKS = (" [{}]", " ({})", "[{}]", ", {}", "/{}", "_{}", " {}", ".{}", " in {}", " {{{}}}")


def drawn(rng: random.Random) -> tuple[str, str | None]:
    """A heading of words, with brackets or a unit of a dimension or neither, and that unit."""
    title = rng.choice((" ", "_", "-", ".")).join(rng.choices(WORDS, k=rng.randint(1, 3)))
    if rng.random() < 0.5:
        return title + (f" ({rng.choice(WORDS)})" if rng.random() < 0.2 else ""), None
    unit = rng.choice(WRITTEN[rng.choice(list(WRITTEN))])
    return title + rng.choice(MARKS).format(unit), unit


def invented(count: int) -> list[tuple[str, str, str]]:
    """The headings among `count` for which a unit is found that nobody wrote, each with its dimension."""
    rng, found = random.Random(1), []  # noqa: S311 - no secret
    in_words = {"turn", "revolution", "second", "minute", "hour", "degree", "radian", "min", "rev"}
    for _ in range(count):
        title, written = drawn(rng)
        for dimension in WRITTEN:
            try:
                unit = unit_of(title, dimension)
            except WrongUse as error:
                if "two units" in str(error):
                    found.append((title, dimension, str(error)))
                continue
            is_it = written is not None and units.known(dimension, written) is not None and unit is not None
            if is_it and math.isclose(units.factor(dimension, unit or ""), units.factor(dimension, written or "")):
                continue
            if unit is not None and set(re.split("[/_]", unit)) <= in_words.union(*WRITTEN.values()):
                continue  # "turn in rev" and "motor rev/s" do state one
            bracketed = title.rpartition("(")[2].removesuffix(")") if written is None and title.endswith(")") else ""
            if unit is not None and bracketed.lower() not in in_words:  # "time (second)" does state one
                found.append((title, dimension, unit))
    return found


def test_no_word_of_a_heading_is_a_unit() -> None:
    assert invented(150) == []


@pytest.mark.study
def test_no_word_of_ten_thousand_headings_is_a_unit() -> None:
    assert invented(10_000) == []


def test_a_word_that_a_unit_is_called_by_too_is_part_of_the_name() -> None:
    assert unit_of("joint rotation", "angle") is None
    assert unit_of("torqueMilliNm", "torque") is None
    assert unit_of("knee rotation (rad)", "angle") == "rad"
    assert "joint" not in names("joint rotation")
