"""The packets with which another process switches off the torque of a servo on a serial line."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from drivers.off_path import OffPath, descriptor_of, serial_interval

if TYPE_CHECKING:
    from drivers.packets.control_table import ControlTable
    from drivers.packets.port import SerialPort

_RESYNC = bytes(32)
"""Zero bytes, more than any packet sent here has. They end a packet that was cut off (its checksum is then wrong) and
begin none.
"""


def off_path(
    port: SerialPort,
    table: ControlTable,
    off: Iterable[str],
    *,
    zero_after: Iterable[str] = (),
    kept: Iterable[str] = (),
    neighbours: Iterable[int] = (),
) -> OffPath:
    """Return the packets that switch the torque off and that restore the settings, for another process to send.

    off: registers to which zero is written to switch the torque off. zero_after: registers to which zero is written
    afterwards. kept: registers that are not restored. neighbours: ids of servos whose torque is switched off too.
    """
    packets = tuple(table.unanswered(name, 0, neighbours if name == "torque_enable" else ()) for name in off)
    kept = frozenset(kept)
    settings = [(name, value) for name, value in table.settings.changed() if name not in kept]
    return OffPath(
        off=packets,
        restore=tuple(
            table.unanswered(name, value) for name, value in [*((name, 0) for name in zero_after), *settings]
        ),
        resync=_RESYNC,
        descriptor=descriptor_of(port.ser),
        interval=serial_interval((_RESYNC, *packets), port.baudrate),
        name=port.port_name,
    )
