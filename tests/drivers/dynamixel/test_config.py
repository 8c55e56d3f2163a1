"""The validation of the [dynamixel] table of a stand file."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from drivers.dynamixel.config import DynamixelConfig

TABLE = TypeAdapter(DynamixelConfig)
GOOD: dict[str, Any] = {"port": "/dev/ttyUSB0", "model": "xm430-w350"}


def test_ten_lines_are_enough() -> None:
    config = TABLE.validate_python(GOOD | {"id": 3, "baudrate": 4_000_000, "sign": -1})
    assert (config.id, config.baudrate, config.effective_mode) == (3, 4_000_000, "current")
    assert TABLE.validate_python({"port": "p", "model": "xl430-w250"}).effective_mode == "extended-position"


@pytest.mark.parametrize("name", ["xl320", "XL-320", "ax-12a", "AX-18", "mx-28", "rx-64"])
def test_a_servo_that_measures_no_current_is_refused_with_the_reason_and_not_as_unknown(name: str) -> None:
    said = rf"{name}.: it measures no current.+use a servo of the X series"
    with pytest.raises(ValueError, match=said):
        TABLE.validate_python(GOOD | {"model": name})
    with pytest.raises(ValueError, match=said):
        DynamixelConfig("p", name)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"id": 253}, "id"),
        ({"id": "one"}, "id"),
        ({"baudrate": 1_152_000}, "baudrate"),
        ({"sign": 0}, "sign"),
        ({"mode": "velocity"}, "mode"),
        ({"torque_constant": 0.0}, "torque_constant"),
        ({"torque_constant": float("nan")}, "torque_constant"),
        ({"return_delay": 1e-3}, "return_delay"),
        ({"watchdog": 3.0}, "watchdog"),
        ({"reply_timeout": 0.0}, "reply_timeout"),
        ({"bauderate": 57600}, "bauderate"),
    ],
)
def test_what_cannot_be_is_refused_at_its_key(change: dict[str, Any], key: str) -> None:
    with pytest.raises(ValidationError) as caught:
        TABLE.validate_python(GOOD | change)
    assert [error["loc"][0] for error in caught.value.errors()] == [key]
