"""List the serial ports and CAN interfaces of this computer, with the problem of each and its remedy.

Latency timers and CAN interfaces are read from Linux's /sys and from the command `ip`; on other systems they are left
out.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import stat
import subprocess
import sys as system
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from serial.tools.list_ports import comports

_SYS = Path("/sys")
_CAN_TYPE = "280"  # ARPHRD_CAN in /sys/class/net/NAME/type
_PTYS = frozenset({2, 3, *range(128, 144)})
"""The major device numbers of pseudo terminals in Linux, Documentation/admin-guide/devices.txt."""
_ON_SERIAL = frozenset({"slcan", "serial", "robotell", "seeedstudio", "damiao"})
_NO_WIRE = frozenset({"virtual", "udp_multicast", "socketcand"})
_LATENCY = 1  # ms; needed for one round trip a tick


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port or a CAN interface. described: the device that is connected. problem: what is wrong, with the
    remedy; "" if nothing is.
    """

    name: str
    described: str
    problem: str = ""


def serial_ports(sys: Path = _SYS) -> list[Port]:
    """Return the serial ports, without the mainboard's own ports, to which rarely anything is connected. sys: path of
    Linux's /sys.
    """
    ports = []
    for port in sorted(comports(), key=lambda port: str(port.device)):
        if port.vid is None and port.device.startswith("/dev/ttyS"):
            continue
        described = " ".join(str(text) for text in (port.description, port.serial_number) if text not in {None, "n/a"})
        ports.append(Port(port.device, described, serial_problem(Path(port.device), sys)))
    return ports


def serial_problem(port: Path, sys: Path = _SYS) -> str:
    """Return the problem of `port` with the remedy, "" if it has none. The port is not opened. sys: path of Linux's
    /sys.
    """
    real = port.resolve()
    if os.name == "posix":
        if not real.exists():
            return f"{port} does not exist: check the cable and the name"
        if not os.access(real, os.R_OK | os.W_OK):
            return f"no permission to read and write {port}: {_permission(real)}"
    latency = latency_timer(real.name, sys)
    if latency is not None and latency > _LATENCY:
        return (
            f"the USB adapter of {port} delays replies by {latency} ms: "
            f"echo {_LATENCY} | sudo tee /sys/bus/usb-serial/devices/{real.name}/latency_timer"
        )
    return ""


def latency_timer(name: str, sys: Path = _SYS) -> int | None:
    """Return the latency timer of an FTDI adapter, ms: how long it delays received bytes. None for any other port."""
    try:
        return int((sys / "bus/usb-serial/devices" / name / "latency_timer").read_text())
    except (OSError, ValueError):
        return None


def set_latency_timer(name: str, milliseconds: int, sys: Path = _SYS) -> bool:
    """Set the latency timer of an FTDI adapter, ms. Return False if this user is not permitted to."""
    try:
        (sys / "bus/usb-serial/devices" / name / "latency_timer").write_text(str(milliseconds))
    except OSError:
        return False
    return True


def can_interfaces(sys: Path = _SYS, details: Callable[[str], Mapping[str, Any]] | None = None) -> list[Port]:
    """Return the CAN interfaces of the Linux kernel.

    details: returns what `ip -json` prints about an interface; None runs `ip`. sys: path of Linux's /sys.
    """
    interfaces = []
    for folder in sorted((sys / "class/net").glob("*")):
        with contextlib.suppress(OSError):
            if (folder / "type").read_text().strip() == _CAN_TYPE:
                interfaces.append(_can_interface(folder.name, (details or _ask_ip)(folder.name)))
    return interfaces


def _can_interface(name: str, link: Mapping[str, Any]) -> Port:
    kind = link.get("linkinfo", {}).get("info_kind", "can")
    data = link.get("linkinfo", {}).get("info_data", {})
    bitrate = data.get("bittiming", {}).get("bitrate")
    state = str(data.get("state", link.get("operstate", "unknown")))
    words = [str(kind), *([f"{bitrate} bit/s"] if bitrate else []), state.lower()]
    bits = f" type can bitrate {bitrate or 1000000}" if kind == "can" else ""
    problem = ""
    if "UP" not in link.get("flags", ["UP"]):
        problem = f"{name} is down: sudo ip link set {name} up{bits}"
    elif state == "BUS-OFF":
        problem = (
            f"{name} is bus-off: no acknowledgement, or the bit rate is wrong; check power, both 120 ohm resistors and "
            f"the bit rate, then sudo ip link set {name} down && sudo ip link set {name} up"
        )
    elif state in {"ERROR-PASSIVE", "ERROR-WARNING"}:
        problem = f"{name} sees many errors ({state.lower()}): check the wires, the resistors and the bit rate"
    return Port(name, ", ".join(words), problem)


def _ask_ip(name: str) -> Mapping[str, Any]:
    program = shutil.which("ip")
    if program is None:
        return {}
    try:
        asked = subprocess.run(  # noqa: S603 - a name that /sys gave, to a program found on the path
            [program, "-details", "-json", "link", "show", name], capture_output=True, check=True, timeout=5.0
        )
        link: Mapping[str, Any] = json.loads(asked.stdout)[0]
    except (subprocess.SubprocessError, OSError, ValueError, IndexError):
        return {}
    return link


def _permission(port: Path) -> str:
    """Return how this user can get access to `port`: by joining its group; otherwise, such as for root's group, by a
    change of its permissions.
    """
    try:
        group, mode = port.group(), port.stat().st_mode
    except (KeyError, OSError, NotImplementedError):
        group, mode = "dialout", 0o660
    if group in {"root", "wheel"} or mode & 0o060 != 0o060:
        return f"its group ({group}) gives nobody access, so until it is plugged in again: sudo chmod a+rw {port}"
    return f"sudo usermod -aG {group} $USER, then log in again"


def emulation(table: object, sys: Path = _SYS) -> str:
    """Return the kind of link if the drive of the stand file's `table` may be an emulator ("pty", "vcan0", ...); "" for
    a port or an adapter of this computer's hardware.

    The device decides, not its name: a symlink to a pty is a pty. sys: path of Linux's /sys.
    """
    interface = getattr(table, "interface", None)
    place = getattr(table, "port" if interface is None else "channel", None)
    if not isinstance(place, str):
        return ""
    if interface in _NO_WIRE:
        return str(interface)
    if interface == "socketcan":
        return "" if (sys / "class" / "net" / place / "device").exists() else place
    if interface is not None and interface not in _ON_SERIAL:
        return ""
    return _serial_emulation(place.partition("@")[0] if interface else place, sys)


def _serial_emulation(name: str, sys: Path) -> str:
    if "://" in name:
        return name.partition("://")[0]
    if os.name != "posix":
        return ""
    try:
        device = Path(name).stat()
    except OSError:
        return "no port"
    if system.platform != "linux":
        return "pty" if Path(name).resolve().name.startswith("ttys") else ""
    number = device.st_rdev
    if not stat.S_ISCHR(device.st_mode) or os.major(number) in _PTYS:
        return "pty"
    known = sys / "dev" / "char"
    wired = not known.exists() or (known / f"{os.major(number)}:{os.minor(number)}" / "device").exists()
    return "" if wired else "virtual port"
