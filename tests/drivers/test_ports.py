"""Serial ports and CAN interfaces as Linux shows them, from folders that look like its own."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers import ports
from hil.cli.app import run


def usb_port(sys: Path, name: str, latency: int) -> None:
    folder = sys / "bus/usb-serial/devices" / name
    folder.mkdir(parents=True)
    (folder / "latency_timer").write_text(f"{latency}\n")


def test_an_adapter_that_delays_replies_is_reported_with_the_command_that_corrects_it(tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    usb_port(tmp_path, "ttyUSB0", 16)
    problem = ports.serial_problem(port, tmp_path)
    assert "by 16 ms" in problem
    assert problem.endswith("echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer")


def test_a_port_behind_a_link_is_judged_by_what_it_leads_to(tmp_path: Path) -> None:
    usb_port(tmp_path, "ttyUSB3", 16)
    (tmp_path / "ttyUSB3").touch()
    link = tmp_path / "by-id"
    link.symlink_to(tmp_path / "ttyUSB3")
    assert "latency_timer" in ports.serial_problem(link, tmp_path)


@pytest.mark.parametrize("latency", [None, 1])
def test_a_port_without_fault_has_no_problem(tmp_path: Path, latency: int | None) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    if latency is not None:
        usb_port(tmp_path, "ttyUSB0", latency)
    assert ports.serial_problem(port, tmp_path) == ""


@pytest.mark.parametrize(
    ("group", "mode", "remedy"),
    [("uucp", 0o660, "usermod -aG uucp $USER"), ("uucp", 0o600, "chmod a+rw"), ("root", 0o660, "chmod a+rw")],
)
def test_a_port_without_permission_is_reported_with_the_group_to_join_where_that_helps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: str, mode: int, remedy: str
) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    port.chmod(mode)
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(Path, "group", lambda _: group)
    assert f"sudo {remedy}" in ports.serial_problem(port, tmp_path)


def link(state: str, *, up: bool = True, kind: str = "can") -> dict[str, Any]:
    """What `ip -details -json link show can0` prints, as far as it is read."""
    return {
        "ifname": "can0",
        "flags": ["NOARP", "ECHO", *(["UP"] if up else [])],
        "operstate": "UP" if up else "DOWN",
        "linkinfo": {"info_kind": kind, "info_data": {"state": state, "bittiming": {"bitrate": 500000}}},
    }


@pytest.mark.parametrize(
    ("details", "described", "problem"),
    [
        (link("ERROR-ACTIVE"), "can, 500000 bit/s, error-active", ""),
        (link("STOPPED", up=False), "can, 500000 bit/s, stopped", "ip link set can0 up type can bitrate 500000"),
        (link("BUS-OFF"), "can, 500000 bit/s, bus-off", "both 120 ohm resistors"),
        (link("ERROR-PASSIVE"), "can, 500000 bit/s, error-passive", "sees many errors"),
        ({"flags": ["UP"], "operstate": "UNKNOWN", "linkinfo": {"info_kind": "vcan"}}, "vcan, unknown", ""),
        ({}, "can, unknown", ""),
    ],
)
def test_a_can_interface_is_described_and_its_fault_reported_with_the_remedy(
    tmp_path: Path, details: Mapping[str, Any], described: str, problem: str
) -> None:
    for name, kind in (("can0", "280"), ("eth0", "1")):
        (tmp_path / "class/net" / name).mkdir(parents=True)
        (tmp_path / "class/net" / name / "type").write_text(f"{kind}\n")
    (found,) = ports.can_interfaces(tmp_path, lambda _: details)
    assert (found.name, found.described) == ("can0", described)
    assert problem in found.problem
    assert bool(problem) == bool(found.problem)


def test_the_command_lists_what_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def port(device: str, vid: int | None) -> SimpleNamespace:
        return SimpleNamespace(device=device, description="USB2Dynamixel", serial_number="A1", vid=vid)

    present = [port("/dev/ttyS0", None), port(str(tmp_path / "ttyUSB7"), 0x0403)]
    monkeypatch.setattr("drivers.ports.comports", lambda: present)
    assert run(["doctor"]) == 0
    said = capfd.readouterr().out
    assert "ttyS0" not in said
    assert f"serial port {tmp_path / 'ttyUSB7'} (USB2Dynamixel A1)" in said
    assert "problem: " in said
