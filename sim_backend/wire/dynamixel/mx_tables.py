"""The control tables of the MX-64 and MX-106 with protocol 1.0, as the e-manual prints them.

Sources: emanual.robotis.com/docs/en/dxl/mx/mx-64/ and .../mx-106/. Ranges are those of the items' descriptions.
"""

from __future__ import annotations

from sim_backend.wire.dynamixel.tables import DynamixelModel
from sim_backend.wire.packets.registers import Item

MX_BAUD = {
    1: 1_000_000,
    3: 500_000,
    4: 400_000,
    7: 250_000,
    9: 200_000,
    16: 115_200,
    34: 57_600,
    103: 19_200,
    207: 9_600,
    250: 2_250_000,
    251: 2_500_000,
    252: 3_000_000,
}
"""bit/s by the value of Baud Rate(4)."""

MX_EEPROM_END = 24
MX_RPM = 0.114 * 2.0 * 3.141592653589793 / 60.0
"""rad/s a count of speed."""


def _items(number: int, volts: int, *, dual: bool) -> tuple[Item, ...]:
    items = [
        Item(0, 2, "model_number", number, writable=False),
        Item(2, 1, "firmware_version", 41, writable=False),
        Item(3, 1, "id", 1, 0, 252),
        Item(4, 1, "baud_rate", 34, 0, 254),
        Item(5, 1, "return_delay_time", 250, 0, 254),
        Item(6, 2, "cw_angle_limit", 0, 0, 4095),
        Item(8, 2, "ccw_angle_limit", 4095, 0, 4095),
        Item(11, 1, "temperature_limit", 80, 0, 100),
        Item(12, 1, "min_voltage_limit", 60, 50, 250),
        Item(13, 1, "max_voltage_limit", volts, 50, 250),
        Item(14, 2, "max_torque", 1023, 0, 1023),
        Item(16, 1, "status_return_level", 2, 0, 2),
        Item(17, 1, "alarm_led", 36, 0, 127),
        Item(18, 1, "shutdown", 36, 0, 127),
        Item(20, 2, "multi_turn_offset", 0, -24_576, 24_576),
        Item(22, 1, "resolution_divider", 1, 1, 4),
        Item(24, 1, "torque_enable", 0, 0, 1),
        Item(25, 1, "led", 0, 0, 1),
        Item(26, 1, "d_gain", 0, 0, 254),
        Item(27, 1, "i_gain", 0, 0, 254),
        Item(28, 1, "p_gain", 32, 0, 254),
        Item(30, 2, "goal_position", 0, -28_672, 28_672),
        Item(32, 2, "moving_speed", 0, 0, 2047),
        Item(34, 2, "torque_limit", 1023, 0, 1023),
        Item(36, 2, "present_position", low=-28_672, writable=False),
        Item(38, 2, "present_speed", writable=False),
        Item(40, 2, "present_load", writable=False),
        Item(42, 1, "present_voltage", writable=False),
        Item(43, 1, "present_temperature", writable=False),
        Item(44, 1, "registered", writable=False),
        Item(46, 1, "moving", writable=False),
        Item(47, 1, "lock", 0, 0, 1),
        Item(48, 2, "punch", 0, 0, 1023),
        Item(50, 2, "realtime_tick", writable=False),
        Item(68, 2, "current", 2048, 0, 4095),
        Item(70, 1, "torque_control", 0, 0, 1),
        Item(71, 2, "goal_torque", 0, 0, 2047),
        Item(73, 1, "goal_acceleration", 0, 0, 254),
    ]
    if dual:
        items.append(Item(10, 1, "drive_mode", 0, 0, 3))
    return tuple(sorted(items, key=lambda item: item.address))


MX_MODELS = {
    "mx-64": DynamixelModel(310, 4.5e-3, (12.0, 4.1, 6.0), 63 * MX_RPM / 0.114, 41, (), _items(310, 240, dual=False)),
    "mx-106": DynamixelModel(320, 4.5e-3, (12.0, 5.2, 8.4), 45 * MX_RPM / 0.114, 41, (), _items(320, 160, dual=True)),
}
"""By the name used in stand files. The stall point is the one at the recommended voltage."""
