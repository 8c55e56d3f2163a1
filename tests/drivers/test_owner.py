"""One owner of a link: the second program is refused before it opens anything, and the message names the first."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.canbus import link as link_module
from drivers.canbus.link import BusConfig, CanLink
from drivers.clock import VirtualClock
from drivers.servo import DriverError
from drivers.uart.port import open_port

HOLDS = """
import sys
from drivers.canbus.link import BusConfig, claimed
held = claimed(BusConfig(sys.argv[1], sys.argv[2], 1000000))
print("ready", flush=True)
sys.stdin.read()
"""


@contextmanager
def other_program(interface: str, channel: str) -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, "-c", HOLDS, interface, channel]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "ready\n"
        yield program
        program.kill()


@pytest.mark.skipif(sys.platform != "linux", reason="names of sockets, and /proc")
@pytest.mark.parametrize("interface", ["udp_multicast", "slcan"])
def test_a_second_program_gets_the_name_of_the_first_and_a_killed_one_leaves_no_lock(
    interface: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(_: BusConfig) -> None:
        raise DriverError("opened")

    monkeypatch.setattr(link_module, "open_interface", opened)
    port = tmp_path / "tty"
    port.touch()
    (tmp_path / "by-id").symlink_to(port)
    config = BusConfig(interface, f"{tmp_path}/by-id@115200" if interface == "slcan" else "239.0.0.251", 1_000_000)
    with other_program(interface, str(port) if interface == "slcan" else "239.0.0.251") as program:
        for _ in range(3):
            with pytest.raises(DriverError, match=rf"in use by process {program.pid} \(python\S* \S+.*\): two"):
                CanLink(config, VirtualClock())
        if interface == "slcan":
            with pytest.raises(DriverError, match=f"in use by process {program.pid} "):
                link_module.claimed(BusConfig("robotell", str(port), 1_000_000))
        program.kill()
        program.wait()
        with pytest.raises(DriverError, match="opened"):
            CanLink(config, VirtualClock())


def test_a_bus_is_one_however_it_is_spelled_and_free_after_it_was_closed() -> None:
    clock = VirtualClock()
    first = CanLink(BusConfig("virtual", "0", 1_000_000), clock)
    with pytest.raises(DriverError, match="open in this program already"):
        CanLink(BusConfig("virtual", " 00", 500_000), clock)
    first.close()
    CanLink(BusConfig("virtual", "00", 1_000_000), clock).close()


@pytest.mark.parametrize("error", [NameError("canOpen"), TypeError(), RecursionError("deep"), AttributeError("windll")])
def test_whatever_an_interface_raises_while_it_opens_is_one_sentence(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("can.Bus", refuse)
    with pytest.raises(DriverError, match=r"^kvaser 0: .*install the driver and the library of the adapter's maker"):
        CanLink(BusConfig("kvaser", "0", 1_000_000), VirtualClock())
    monkeypatch.setattr("serial.Serial", refuse)
    with pytest.raises(DriverError, match=r"^tty: .*check port and baud rate"):
        open_port("tty", 1 << 70)
