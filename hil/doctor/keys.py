"""The keys of the stand file on which each check depends, so that an error can name the keys to change."""

from __future__ import annotations

from typing import Any

from hil.stand.file import Stand

_DEVICE = {
    "port": ("port", "channel", "interface"),
    "connection": ("port", "channel", "id", "model", "profile", "baudrate", "bitrate"),
    "drive": ("reply_timeout", "watchdog", "reset_faults"),
    "bus": ("baudrate", "bitrate", "reply_timeout"),
    "torque off": ("reply_timeout",),
    "watchdog": ("watchdog",),
    "signs": ("sign",),
}
"""For each check, the keys of the drive's table on which it depends."""
_SENSOR = {"joint sensor": ("port", "baudrate", "format"), "signs": ("sign",)}
_STAND = {
    "readings": ("stand.torque_source",),
    "stop": ("limits.torque", "limits.deflection"),
    "move": ("limits.torque", "limits.deflection", "limits.velocity"),
    "lock": ("stand.gear_ratio", "stand.torque_source"),
}


def keys_of(stand: Stand) -> dict[str, tuple[str, ...]]:
    """Return, for each check by name, the keys of the stand file on which it depends, as "table.key"."""
    found: dict[str, list[str]] = {name: list(keys) for name, keys in _STAND.items()}
    backend = str(stand.stand.backend)
    for table, related in ((backend, _DEVICE), ("joint_sensor", _SENSOR)):
        config: Any = stand.devices.get(backend) if table == backend else stand.sensor and stand.sensor[1]
        for name, keys in related.items():
            found.setdefault(name, []).extend(f"{table}.{key}" for key in keys if hasattr(config, key))
    return {name: tuple(keys) for name, keys in found.items() if keys}
