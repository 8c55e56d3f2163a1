"""The memory tables of Feetech's servos, as the vendor prints them: one line an item.

Sources: the vendor's memory tables "STS3215 V3.6", "HLS" and "SCSCL" (doc.feetech.cn), and product specifications.
Where they are silent: the firmware numbers within a series, what an HLS3930M and an HLS2915M hold in Phase(18) and
Unloading Condition(19) (as read from an ORCA hand), and the stall current of an STS3250, which is a guess.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sim_backend.wire.packets.registers import Item

BAUD = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)
"""bit/s by the value of Baud Rate(6)."""
EEPROM_END = 40
CURRENT_LSB = 6.5e-3
"""A a count."""


@dataclass(frozen=True, slots=True)
class FeetechModel:
    """A servo as its specification describes it.

    number: main and sub version. firmware: major and minor. stall: V, A, N m at stall. count: rad a count of position.
    big: words have the high byte first.
    """

    number: tuple[int, int]
    firmware: tuple[int, int]
    stall: tuple[float, float, float]
    count: float
    big: bool
    items: tuple[Item, ...]


def _read_only(address: int, size: int, name: str, initial: int = 0, sign_bit: int = 0) -> Item:
    return Item(address, size, name, initial, sign_bit=sign_bit, writable=False)


def _common(highest_voltage: int) -> list[Item]:
    return [
        _read_only(0, 1, "firmware_major"),
        _read_only(1, 1, "firmware_minor"),
        _read_only(2, 1, "endianness"),
        _read_only(3, 1, "main_version"),
        _read_only(4, 1, "sub_version"),
        Item(5, 1, "id", 1, 0, 253),
        Item(6, 1, "baud_rate", 0, 0, 7),
        Item(8, 1, "response_level", 1, 0, 1),
        Item(9, 2, "min_position_limit", 0, 0, 4094),
        Item(11, 2, "max_position_limit", 4095, 0, 4095),
        Item(13, 1, "temperature_limit", 70, 0, 100),
        Item(14, 1, "max_voltage_limit", highest_voltage, 0, 254),
        Item(15, 1, "min_voltage_limit", 40, 0, 254),
        Item(16, 2, "max_torque", 1000, 0, 1000),
        Item(18, 1, "phase", 12, 0, 254),
        Item(19, 1, "unloading_condition", 44, 0, 254),
        Item(20, 1, "led_alarm", 47, 0, 254),
        Item(21, 1, "p_gain", 32, 0, 254),
        Item(22, 1, "d_gain", 32, 0, 254),
        Item(23, 1, "i_gain", 0, 0, 254),
        Item(26, 1, "cw_dead_zone", 1, 0, 32),
        Item(27, 1, "ccw_dead_zone", 1, 0, 32),
        Item(40, 1, "torque_enable", 0, 0, 128),
        _read_only(56, 2, "present_position", sign_bit=15),
        _read_only(58, 2, "present_speed", sign_bit=15),
        _read_only(60, 2, "present_load", sign_bit=10),
        _read_only(62, 1, "present_voltage"),
        _read_only(63, 1, "present_temperature"),
        _read_only(64, 1, "registered"),
        _read_only(65, 1, "status"),
        _read_only(66, 1, "moving"),
    ]


def _magnetic(highest_voltage: int) -> list[Item]:
    """Return what STS and HLS share beside `_common`."""
    return [
        *_common(highest_voltage),
        Item(30, 1, "angular_resolution", 1, 1, 100),
        Item(33, 1, "operating_mode", 0, 0, 3),
        Item(37, 1, "speed_p_gain", 10, 0, 254),
        Item(38, 1, "over_current_time", 200, 0, 254),
        Item(39, 1, "speed_i_gain", 10, 0, 254),
        Item(41, 1, "acceleration", 0, 0, 254),
        Item(42, 2, "goal_position", 0, -32767, 32767, 15),
        Item(48, 2, "torque_limit", 1000, 0, 1000),
        _read_only(69, 2, "present_current", sign_bit=15),
        _read_only(71, 1, "reserved"),
    ]


def _sts(highest_voltage: int) -> tuple[Item, ...]:
    return (
        *_magnetic(highest_voltage),
        Item(7, 1, "return_delay", 0, 0, 254),
        Item(24, 2, "least_force", 16, 0, 1000),
        Item(28, 2, "protection_current", 500, 0, 511),
        Item(31, 2, "position_offset", 0, -2047, 2047, 11),
        Item(34, 1, "protective_torque", 20, 0, 254),
        Item(35, 1, "protection_time", 200, 0, 254),
        Item(36, 1, "overload_torque", 80, 0, 254),
        Item(44, 2, "goal_time", 0, -1000, 1000, 10),
        Item(46, 2, "goal_velocity", 0, -32767, 32767, 15),
        Item(55, 1, "lock", 0, 0, 1),
    )


def _hls(highest_voltage: int, phase: int, protection: int) -> tuple[Item, ...]:
    items = [
        *_magnetic(highest_voltage),
        Item(7, 1, "second_id", 253, 0, 253),
        Item(24, 1, "least_force", 16, 0, 254),
        Item(25, 1, "integral_limit", 0, 0, 254),
        Item(28, 2, "protection_current", protection, 0, 2047),
        Item(31, 2, "position_offset", 0, -4095, 4095, 15),
        Item(34, 1, "current_p_gain", 20, 0, 254),
        Item(35, 1, "current_i_gain", 10, 0, 254),
        Item(44, 2, "goal_torque", protection, -2047, 2047, 15),
        Item(46, 2, "goal_velocity", 100, -32767, 32767, 15),
        Item(55, 1, "lock", 1, 0, 1),
        _read_only(67, 2, "target_position", sign_bit=15),
    ]
    changed = {"phase": phase, "unloading_condition": 13}
    return tuple(replace(item, initial=changed.get(item.name, item.initial)) for item in items)


def _scs() -> tuple[Item, ...]:
    items = [
        *_common(80),
        Item(7, 1, "return_delay", 0, 0, 254),
        Item(24, 2, "least_force", 0, 0, 1000),
        Item(37, 1, "protective_torque", 20, 0, 254),
        Item(38, 1, "protection_time", 200, 0, 254),
        Item(39, 1, "overload_torque", 80, 0, 254),
        Item(42, 2, "goal_position", 0, 0, 1023),
        Item(44, 2, "goal_time", 0, 0, 9999),
        Item(46, 2, "goal_velocity", 0, 0, 32767),
        Item(48, 1, "lock", 0, 0, 1),
    ]
    changed = {"max_position_limit": 1023, "endianness": 1}
    return tuple(replace(item, initial=changed.get(item.name, item.initial)) for item in items)


_STEP = 2.0 * math.pi / 4096.0
MODELS = {
    "sts3215": FeetechModel((9, 3), (3, 6), (12.0, 2.7, 2.94), _STEP, False, _sts(140)),
    "sts3250": FeetechModel((9, 11), (3, 9), (12.0, 3.6, 4.90), _STEP, False, _sts(140)),
    "hls3606m": FeetechModel((10, 10), (3, 42), (6.0, 1.0, 0.59), _STEP, False, _hls(90, 16, 450)),
    "hls2915m": FeetechModel((10, 27), (3, 45), (12.0, 1.5, 1.39), _STEP, False, _hls(160, 52, 450)),
    "hls3930m": FeetechModel((10, 16), (3, 45), (12.0, 2.8, 3.43), _STEP, False, _hls(160, 16, 1000)),
    "scs0009": FeetechModel((5, 4), (0, 8), (6.0, 1.0, 0.226), math.radians(300.0) / 1024.0, True, _scs()),
}
"""By the name used in stand files. The stall point is the one at the highest voltage."""
