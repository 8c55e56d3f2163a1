"""The table of each drive in a stand file: a few lines are enough, and what cannot be is refused at its key."""

from __future__ import annotations

import re
from math import nan
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from drivers.canbus.link import BusConfig
from drivers.cia402.config import Cia402Config
from drivers.commander.config import CommanderConfig
from drivers.dynamixel.config import DynamixelConfig
from drivers.feetech.config import FeetechConfig
from drivers.mit.config import MitConfig
from drivers.moteus.config import MoteusConfig
from drivers.odrive.config import OdriveConfig
from drivers.robstride.config import RobstrideConfig

Table = dict[str, Any]
CAN: Table = {"interface": "socketcan", "channel": "can0"}
GOOD: dict[str, tuple[Any, Table]] = {
    "dynamixel": (DynamixelConfig, {"port": "/dev/ttyUSB0", "model": "xm430-w350"}),
    "feetech": (FeetechConfig, {"port": "x", "model": "sts3215"}),
    "odrive": (OdriveConfig, CAN | {"torque_constant": 0.04}),
    "cia402": (Cia402Config, CAN | {"profile": "epos4"}),
    "moteus": (MoteusConfig, CAN),
    "mit": (MitConfig, CAN | {"model": "dm-j4310"}),
    "robstride": (RobstrideConfig, CAN | {"model": "rs03"}),
    "commander": (CommanderConfig, {"port": "/dev/ttyACM0", "torque_constant": 0.05, "watchdog": 0.1}),
}


def read(kind: str, change: Table) -> Any:
    config, good = GOOD[kind]
    return TypeAdapter(config).validate_python(good | change)


@pytest.mark.parametrize(
    ("kind", "change", "attribute", "value"),
    [
        ("dynamixel", {"id": 3, "baudrate": 4_000_000, "sign": -1}, "effective_mode", "current"),
        ("dynamixel", {"model": "xl430-w250"}, "effective_mode", "extended-position"),
        ("odrive", {"id": 3, "sign": -1}, "id", 3),
        ("cia402", {"id": 3, "sign": -1}, "id", 3),
        ("moteus", {"id": 3, "sign": -1}, "id", 3),
        ("mit", {"id": 3, "reply_id": 0x13}, "reply_ids", {0x13}),
        ("mit", {"model": "ak80-9", "id": 104}, "reply_ids", {0, 104}),
        ("robstride", {}, "host_id", 0xFD),
        ("commander", {}, "motor", "M"),
    ],
)
def test_a_few_lines_are_enough(kind: str, change: Table, attribute: str, value: Any) -> None:
    assert getattr(read(kind, change), attribute) == value


def test_a_moteus_has_can_fd() -> None:
    bus = BusConfig.of(read("moteus", {}))
    assert (bus.bitrate, bus.data_bitrate) == (1_000_000, 5_000_000)


WRONG: dict[str, list[tuple[Table, str]]] = {
    "dynamixel": [
        ({"id": 253}, "id"),
        ({"id": "one"}, "id"),
        ({"baudrate": 1_152_000}, "baudrate"),
        ({"sign": 0}, "sign"),
        ({"mode": "velocity"}, "mode"),
        ({"torque_constant": 0.0}, "torque_constant"),
        ({"torque_constant": nan}, "torque_constant"),
        ({"return_delay": 1e-3}, "return_delay"),
        ({"watchdog": 3.0}, "watchdog"),
        ({"reply_timeout": 0.0}, "reply_timeout"),
        ({"bauderate": 57600}, "bauderate"),
        ({"model": "xl430-w250", "mode": "current"}, r".*dynamixel\.mode.*"),
        ({"watchdog": 0.01}, r".*dynamixel\.watchdog.*"),
        ({"model": "mx-64"}, ".*the mx-64 has none: set it to 0.*"),
        ({"model": "mx-64", "watchdog": 0.0, "mode": "current-based-position"}, ".*current and extended-position.*"),
        ({"model": "mx-64", "watchdog": 0.0, "baudrate": 4_000_000}, ".*no code for it.*"),
    ],
    "feetech": [
        ({"baudrate": 19_200}, "baudrate"),
        ({"mode": "torque"}, ".*has none, only position.*"),
        ({"model": "hls3930m", "return_delay": 1e-4}, ".*set it to 0.*"),
        ({"model": "hls3606m"}, ".*torque_constant: must be given.*"),
        ({"model": "scs0009", "torque_constant": 0.2}, ".*measures no current.*"),
    ],
    "odrive": [
        ({"id": 63}, "id"),
        ({"bitrate": 300_000}, "bitrate"),
        ({"torque_constant": 0.0}, "torque_constant"),
        ({"sign": 0}, "sign"),
        ({"chanel": "can0"}, "chanel"),
        ({"watchdog": 0.01}, r".*odrive\.watchdog.*"),
    ],
    "cia402": [
        ({"id": 0}, "id"),
        ({"bitrate": 300_000}, "bitrate"),
        ({"profile": "epos5"}, "profile"),
        ({"rated_torque": 0.0}, "rated_torque"),
        ({"resolution": -4096}, "resolution"),
        ({"chanel": "can0"}, "chanel"),
        ({"watchdog": 0.01}, r".*cia402\.watchdog.*"),
        ({"profile": "epos2"}, r".*cia402\.torque_constant.*"),
        ({"id": 127}, r".*cia402\.own_id.*"),
    ],
    "moteus": [
        ({"id": 0}, "id"),
        ({"mode": "velocity"}, "mode"),
        ({"watchdog": 0.0}, "watchdog"),
        ({"sign": 0}, "sign"),
        ({"bit_rate": 1}, "bit_rate"),
        ({"id": 3, "source": 3}, r".*moteus\.source.*"),
    ],
    "mit": [
        ({"id": 0}, "id"),
        ({"torque_scale": 0.0}, "torque_scale"),
        ({"velocity_range": nan}, "velocity_range"),
        ({"sign": 2}, "sign"),
        ({"modell": "x"}, "modell"),
        ({"model": "ak1"}, "model"),
    ],
    "robstride": [
        ({"id": 128}, "id"),
        ({"torque_range": nan}, "torque_range"),
        ({"watchdog": 6}, "watchdog"),
        ({"id": 3, "host_id": 3}, r".*robstride\.host_id 3 is the motor's id.*"),
        ({"model": "cybergear"}, r".*has no watchdog .* set robstride\.watchdog = 0.*"),
    ],
    "commander": [
        ({"watchdog": None}, "watchdog"),
        ({"torque_constant": 0.0}, "torque_constant"),
        ({"motor": "MM"}, "motor"),
        ({"torque_mode": "voltage"}, "torque_mode"),
        ({"sign": 2}, "sign"),
        ({"bauderate": 1}, "bauderate"),
        ({"watchdog": 0.01}, ".*one lost reply.*"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "change", "place"), [(kind, *case) for kind, cases in WRONG.items() for case in cases]
)
def test_what_cannot_be_is_refused_at_its_key_or_in_a_sentence(kind: str, change: Table, place: str) -> None:
    with pytest.raises(ValidationError) as caught:
        read(kind, change)
    (said,) = [str(error["loc"][0]) if error["loc"] else error["msg"] for error in caught.value.errors()]
    assert re.fullmatch(place, said)


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("dynamixel", {"model": "ax-12"}, r"dynamixel\.model"),
        ("dynamixel", {"model": "xl330-m288", "baudrate": 4_500_000}, r"dynamixel\.baudrate"),
        ("feetech", {"model": "sts3216"}, "not known"),
        ("mit", {"model": "ak1"}, r"mit\.model 'ak1' is not known"),
        ("robstride", {"model": "rs9"}, r"robstride\.model 'rs9' is not known"),
    ],
)
def test_what_cannot_be_is_refused_in_python_too(kind: str, change: Table, words: str) -> None:
    config, good = GOOD[kind]
    with pytest.raises(ValueError, match=words):
        config(**good | change)


@pytest.mark.parametrize("name", ["xl320", "XL-320", "ax-12a", "AX-18", "mx-28", "rx-64"])
def test_a_servo_that_measures_no_current_is_refused_with_the_reason_and_not_as_unknown(name: str) -> None:
    said = rf"{name}.: it measures no current.+use a servo of the X series"
    for make in (read, lambda _, change: DynamixelConfig("p", **change)):
        with pytest.raises(ValueError, match=said):
            make("dynamixel", {"model": name})
