"""The control tables of the X series, as the e-manual prints them: one line an item.

Sources, each under emanual.robotis.com/docs/en/dxl/x/: xm430-w210, xm430-w350, xm540-w150, xm540-w270, xl330-m077,
xl330-m288, xc330-t181, xc330-t288, xc330-m181, xc330-m288, xl430-w250. What the manual leaves without a value (goals,
present values, model information) begins at zero here. Initial velocity limits and gains are those of the model where
its page was at hand, else those of its nearest sister.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from sim_backend.wire.packets.registers import Item
from sim_backend.wire.packets.regulator import CURRENT, CURRENT_POSITION, EXTENDED, POSITION, PWM, SPEED


@dataclass(frozen=True, slots=True)
class DynamixelModel:
    """A servo as its page describes it.

    current_lsb: A a count, 0 where it measures none. stall: V, A, N m at stall. speed: rad/s without load.
    indirect: ranges of (first address item, first data item, slots).
    """

    number: int
    current_lsb: float
    stall: tuple[float, float, float]
    speed: float
    firmware: int
    indirect: tuple[tuple[int, int, int], ...]
    items: tuple[Item, ...]


BAUD = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""bit/s by the code in Baud Rate(8)."""

MODES = (CURRENT, SPEED, POSITION, EXTENDED, CURRENT_POSITION, PWM)

RPM = 0.229 * 2.0 * 3.141592653589793 / 60.0
"""rad/s a count of velocity: 0.229 rev/min."""

_R = 2**31 - 1


def _common() -> list[Item]:
    return [
        Item(0, 2, "model_number", writable=False),
        Item(2, 4, "model_information", writable=False),
        Item(6, 1, "firmware_version", writable=False),
        Item(7, 1, "id", 1, 0, 252),
        Item(8, 1, "baud_rate", 1, 0, 7),
        Item(9, 1, "return_delay_time", 250, 0, 254),
        Item(10, 1, "drive_mode", 0, 0, 5),
        Item(11, 1, "operating_mode", POSITION, 0, 16),
        Item(12, 1, "secondary_id", 255, 0, 255),
        Item(13, 1, "protocol_type", 2, 1, 2),
        Item(20, 4, "homing_offset", 0, -1_044_479, 1_044_479),
        Item(24, 4, "moving_threshold", 10, 0, 1023),
        Item(31, 1, "temperature_limit", 80, 0, 100),
        Item(32, 2, "max_voltage_limit", 160, 95, 160),
        Item(34, 2, "min_voltage_limit", 95, 95, 160),
        Item(36, 2, "pwm_limit", 885, 0, 885),
        Item(38, 2, "current_limit", 1193, 0, 1193),
        Item(44, 4, "velocity_limit", 350, 0, 1023),
        Item(48, 4, "max_position_limit", 4095, 0, 4095),
        Item(52, 4, "min_position_limit", 0, 0, 4095),
        Item(60, 1, "startup_configuration", 0, 0, 3),
        Item(63, 1, "shutdown", 52, 0, 63),
        Item(64, 1, "torque_enable", 0, 0, 1),
        Item(65, 1, "led", 0, 0, 1),
        Item(68, 1, "status_return_level", 2, 0, 2),
        Item(69, 1, "registered_instruction", writable=False),
        Item(70, 1, "hardware_error_status", writable=False),
        Item(76, 2, "velocity_i_gain", 1920, 0, 16383),
        Item(78, 2, "velocity_p_gain", 100, 0, 16383),
        Item(80, 2, "position_d_gain", 0, 0, 16383),
        Item(82, 2, "position_i_gain", 0, 0, 16383),
        Item(84, 2, "position_p_gain", 800, 0, 16383),
        Item(88, 2, "feedforward_2nd_gain", 0, 0, 16383),
        Item(90, 2, "feedforward_1st_gain", 0, 0, 16383),
        Item(98, 1, "bus_watchdog", 0, -1, 127),
        Item(100, 2, "goal_pwm", 0, -885, 885),
        Item(102, 2, "goal_current", 0, -32768, 32767),
        Item(104, 4, "goal_velocity", 0, -1023, 1023),
        Item(108, 4, "profile_acceleration", 0, 0, 32767),
        Item(112, 4, "profile_velocity", 0, 0, 32767),
        Item(116, 4, "goal_position", 0, -_R - 1, _R),
        Item(120, 2, "realtime_tick", writable=False),
        Item(122, 1, "moving", writable=False),
        Item(123, 1, "moving_status", writable=False),
        Item(124, 2, "present_pwm", low=-885, writable=False),
        Item(126, 2, "present_current", low=-32768, writable=False),
        Item(128, 4, "present_velocity", low=-_R, writable=False),
        Item(132, 4, "present_position", low=-_R, writable=False),
        Item(136, 4, "velocity_trajectory", low=-_R, writable=False),
        Item(140, 4, "position_trajectory", low=-_R, writable=False),
        Item(144, 2, "present_input_voltage", writable=False),
        Item(146, 1, "present_temperature", writable=False),
        Item(147, 1, "backup_ready", writable=False),
    ]


def _indirect(ranges: tuple[tuple[int, int, int], ...]) -> list[Item]:
    highest = max(data + slots for _, data, slots in ranges) - 1
    items = []
    for address, data, slots in ranges:
        items += [Item(address + 2 * i, 2, "indirect_address", data + i, 64, highest) for i in range(slots)]
        items += [Item(data + i, 1, "indirect_data", 0, 0, 255) for i in range(slots)]
    return items


def _table(
    ranges: tuple[tuple[int, int, int], ...],
    changes: dict[str, tuple[int, int, int]],
    without: tuple[str, ...] = (),
    extra: tuple[Item, ...] = (),
) -> tuple[Item, ...]:
    """The common table with some items' (initial, low, high) changed, some left out and some added."""
    items = [item for item in _common() if item.name not in without]
    items += [*extra, *_indirect(ranges)]
    for i, item in enumerate(items):
        if item.name in changes:
            initial, low, high = changes[item.name]
            items[i] = replace(item, initial=initial, low=low, high=high)
    return tuple(sorted(items, key=lambda item: item.address))


_BIG = ((168, 224, 28), (578, 634, 28))
_SMALL = ((168, 208, 20),)
_PORTS = tuple(Item(56 + i, 1, f"external_port_mode_{i + 1}", 3, 0, 3) for i in range(3)) + tuple(
    Item(152 + 2 * i, 2, f"external_port_data_{i + 1}", 0, 0, 4095) for i in range(3)
)


def _x430(number: int, stall: tuple[float, float, float], rpm: float, velocity: int) -> DynamixelModel:
    items = _table(_BIG, {"velocity_limit": (velocity, 0, 1023)})
    return DynamixelModel(number, 2.69e-3, stall, rpm * RPM / 0.229, 45, _BIG, items)


def _x540(number: int, stall: tuple[float, float, float], rpm: float, velocity: int) -> DynamixelModel:
    changes = {"velocity_limit": (velocity, 0, 1023), "current_limit": (2047, 0, 2047)}
    return DynamixelModel(number, 2.69e-3, stall, rpm * RPM / 0.229, 45, _BIG, _table(_BIG, changes, extra=_PORTS))


def _x330(
    number: int, stall: tuple[float, float, float], rpm: float, velocity: int, *, current: int, shutdown: int
) -> DynamixelModel:
    high = stall[0] > 6.0
    low_voltage, high_voltage = (55, 140) if high else (31, 70)
    changes = {
        "baud_rate": (1, 0, 6),
        "protocol_type": (2, 2, 22),
        "temperature_limit": (70, 0, 100),
        "max_voltage_limit": (high_voltage, low_voltage, high_voltage),
        "min_voltage_limit": (55 if high else 35, low_voltage, high_voltage),
        "current_limit": (current, 0, current),
        "velocity_limit": (velocity, 0, 2047),
        "goal_velocity": (0, -2047, 2047),
        "shutdown": (shutdown, 0, 63),
        "velocity_i_gain": (1600, 0, 16383),
        "velocity_p_gain": (180, 0, 16383),
        "position_p_gain": (400, 0, 16383),
    }
    extra = (Item(62, 1, "pwm_slope", 255 if high else 140, 1, 255),)
    return DynamixelModel(number, 1e-3, stall, rpm * RPM / 0.229, 46, _SMALL, _table(_SMALL, changes, extra=extra))


def _xl430() -> DynamixelModel:
    changes = {
        "temperature_limit": (72, 0, 100),
        "max_voltage_limit": (140, 60, 140),
        "min_voltage_limit": (60, 60, 140),
        "velocity_limit": (265, 0, 1023),
        "velocity_i_gain": (1000, 0, 16383),
        "position_d_gain": (4000, 0, 16383),
        "position_p_gain": (640, 0, 16383),
    }
    load = Item(126, 2, "present_load", low=-1000, writable=False)
    without = ("current_limit", "goal_current", "present_current")
    return DynamixelModel(
        1060, 0.0, (11.1, 1.3, 1.4), 57 * RPM / 0.229, 45, _BIG, _table(_BIG, changes, without, (load,))
    )


MODELS = {
    "xm430-w350": _x430(1020, (12.0, 2.3, 4.1), 46, 350),
    "xm430-w210": _x430(1030, (12.0, 2.3, 3.0), 77, 330),
    "xl430-w250": _xl430(),
    "xm540-w270": _x540(1120, (12.0, 4.4, 10.6), 30, 128),
    "xm540-w150": _x540(1130, (12.0, 4.4, 7.3), 53, 237),
    "xl330-m077": _x330(1190, (5.0, 1.47, 0.215), 383, 1620, current=1750, shutdown=53),
    "xl330-m288": _x330(1200, (5.0, 1.47, 0.52), 103, 445, current=1750, shutdown=53),
    "xc330-t181": _x330(1210, (11.1, 0.80, 0.76), 104, 500, current=910, shutdown=52),
    "xc330-t288": _x330(1220, (11.1, 0.80, 0.92), 65, 320, current=910, shutdown=52),
    "xc330-m181": _x330(1230, (5.0, 1.80, 0.60), 129, 560, current=2352, shutdown=52),
    "xc330-m288": _x330(1240, (5.0, 1.80, 0.93), 81, 350, current=2352, shutdown=52),
}
"""By the name used in stand files. The stall point is the one at the recommended voltage."""
