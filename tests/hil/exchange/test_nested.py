"""Messages: a number that has a name beside it is found by the name, in whatever order the names are sent."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.errors import WrongUse
from hil.exchange.columns import place
from hil.exchange.nested import Columns, columns


@dataclass
class Values:
    """As control_msgs/InterfaceValue."""

    interface_names: list[str]
    values: Any


@dataclass
class States:
    """As control_msgs/DynamicJointState."""

    joint_names: list[str]
    interface_values: list[Values]


@dataclass
class Point:
    """As trajectory_msgs/JointTrajectoryPoint, and as geometry_msgs/Pose where z is a number."""

    positions: Any = ()
    z: float = 0.0


@dataclass
class Controller:
    """As control_msgs/JointTrajectoryControllerState: the names stand above the values."""

    joint_names: list[str]
    actual: Point


@dataclass
class Links:
    """As gazebo_msgs/LinkStates."""

    name: list[str]
    pose: list[Point]


@dataclass
class KeyValue:
    """As diagnostic_msgs/KeyValue."""

    key: str
    value: str


@dataclass
class Status:
    """As diagnostic_msgs/DiagnosticStatus."""

    name: str
    values: list[KeyValue]


@dataclass
class Diagnostics:
    """As diagnostic_msgs/DiagnosticArray."""

    status: list[Status] = field(default_factory=list)


def states(*order: str) -> States:
    numbers = {"finger": [0.1, 0.2], "thumb": [7.0, 8.0]}
    return States(list(order), [Values(["effort", "position"], np.array(numbers[joint])) for joint in order])


def read(*messages: Any, joint: str | None = None) -> Columns:
    return columns("bag", enumerate(messages), joint)


def test_the_numbers_of_a_joint_are_found_in_whatever_order_the_joints_are_sent() -> None:
    found = read(states("finger", "thumb"), states("thumb", "finger"), states("thumb"), joint="finger")
    assert {name: list(values) for name, values in found.values.items()} == {
        "effort": [0.1, 0.1],
        "position": [0.2, 0.2],
    }
    assert list(found.stamps) == [0, 1]
    assert found.joints == ["finger", "thumb"]


def test_without_a_joint_each_number_has_the_names_in_its_path_and_no_index(tmp_path: Path) -> None:
    numbers = read(states("thumb"), states("finger", "thumb")).values
    np.testing.assert_array_equal(numbers["interface_values.finger.values.effort"], [np.nan, 0.1])
    with pytest.raises(WrongUse, match=r"belong to names, whose order changes .*: choose by name"):
        place(tmp_path, list(numbers), "interface_values[0].values[0]")


@pytest.mark.parametrize(
    ("message", "path", "value"),
    [
        (Controller(["thumb", "finger"], Point(np.array([1.0, 2.0]))), "actual.positions.finger", 2.0),
        (Links(["a::base", "a::tip"], [Point(z=1.0), Point(z=2.0)]), "pose.a::tip.z", 2.0),
        (
            Diagnostics([Status("motor 1", [KeyValue("mode", "on"), KeyValue("torque", "0.25")])]),
            "status.motor 1.values.torque",
            0.25,
        ),
    ],
)
def test_names_above_the_values_and_names_in_each_value_count_too(message: Any, path: str, value: float) -> None:
    assert list(read(message).values[path]) == [value]


def test_values_whose_names_are_not_unique_are_not_read() -> None:
    assert read(Links(["tip", "tip"], [Point(z=1.0), Point(z=2.0)])).values == {}


def test_names_that_are_sent_only_once_hold_for_the_rows_that_follow() -> None:
    rows = [{"joints": ["thumb", "finger"]}, {"q": [1.0, 2.0]}, {"joints": ["finger", "thumb"], "q": [3.0, 4.0]}]
    assert list(columns("JSON", enumerate(rows)).values["q.finger"])[1:] == [2.0, 3.0]
