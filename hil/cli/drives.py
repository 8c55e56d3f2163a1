"""`hil doctor` and `hil emulate`: the drives of a stand, and drives that answer on a wire and are not there."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.terminal import STAND_FAILED, Json, out, print_json, say
from hil.errors import WrongUse

if TYPE_CHECKING:
    from drivers.ports import Port
    from hil.examination import Check, Examination


def emulate(
    name: Annotated[str | None, typer.Argument(help="What to emulate; without it, what there is.")] = None,
    model: Annotated[str | None, typer.Option(help="Of several: which.")] = None,
    firmware: Annotated[str | None, typer.Option(help="Of several: which.")] = None,
    ident: Annotated[list[int] | None, typer.Option("--id", help="Its id on the bus; repeat it for several.")] = None,
    link: Annotated[Path | None, typer.Option(help="The serial port to appear as: a symlink to a pty.")] = None,
    bus: Annotated[str | None, typer.Option(help="The CAN bus to sit on: slcan (at --link), udp_multicast ...")] = None,
    channel: Annotated[str | None, typer.Option(help="The channel of --bus.")] = None,
    baudrate: Annotated[int | None, typer.Option(help="bit/s that it listens at.")] = None,
    stand: Annotated[Path | None, typer.Option(help="A stand file, whose [sim] is the plant behind it.")] = None,
    instant: Annotated[bool, typer.Option("--instant", help="Answer at once: no time passes on the wire.")] = False,
) -> None:
    """Answer on a wire as a drive would, until Ctrl-C, with the simulator's plant behind it."""
    from hil.emulators import EMULATORS, ended_by_signal, make

    if name is None:
        for known, emulator in EMULATORS.items():
            out(f"{known:10} {emulator.explanation}")
        return
    words: dict[str, Any] = {"model": model, "idents": ident, "link": link, "bus": bus, "channel": channel}
    words |= {"firmware": firmware, "baudrate": baudrate, "instant": instant or None}
    given = {key: value for key, value in words.items() if value not in (None, [])}
    described = ", ".join(f"{key} {value}" for key, value in given.items())
    if stand is not None:
        from hil.stand import load

        given["parameters"] = load(stand).simulated()
    served = make(name, given)
    with ended_by_signal(served):
        say(f"{name} is there ({described}); Ctrl-C ends it")
        served.serve()
    say("ended")


def doctor(
    stand: Annotated[Path | None, typer.Argument(help="The stand file; without it, ports and CAN interfaces.")] = None,
    move: Annotated[bool, typer.Option("--move", help="Move the motor a little: checks signs and the lock.")] = False,
    amplitude: Annotated[float | None, typer.Option(help="Of --move: N m or rad at the joint; 1/20 limit.")] = None,
    quantity: Annotated[str, typer.Option(help="What is commanded: torque or position.")] = "torque",
    rate: Annotated[float, typer.Option(min=1.0, max=10_000.0, help="Hz that the link is to manage.")] = 500.0,
    as_json: Json = False,
) -> None:
    """Look at ports and CAN interfaces, and with a stand file at the drive: what is wrong and how to mend it.

    With a stand file the drive is connected, listened to for a second, armed at zero torque and stopped again.
    """
    from drivers.ports import can_interfaces, serial_ports
    from drivers.servo import Quantity
    from hil.doctor import examine
    from hil.examination import Examination
    from hil.stand import load

    if quantity not in set(Quantity):
        raise WrongUse(f"unknown --quantity {quantity!r}: known are torque, position")
    if amplitude is not None and not amplitude > 0.0:
        raise WrongUse(f"--amplitude {amplitude:g}: it must be above 0")
    opened = None if stand is None else load(stand)
    ports, interfaces = serial_ports(), can_interfaces()
    found = Examination()
    if not as_json:
        _print_ports("serial port", ports)
        _print_ports("CAN interface", interfaces)
        found.tell = _print_check
    if opened is not None:
        examine(found, opened, Quantity(quantity), rate=rate, move=move, amplitude=amplitude)
    if as_json:
        print_json(_as_json(found, {"serial": ports, "can": interfaces}))
    if found.signal:
        raise typer.Exit(128 + found.signal)
    if not found.ok:
        raise typer.Exit(STAND_FAILED)


def _print_ports(kind: str, ports: list[Port]) -> None:
    if not ports:
        out(f"no {kind} is seen")
    for port in ports:
        out(f"{kind} {port.name}" + (f" ({port.described})" if port.described else ""))
        if port.problem:
            out(f"    problem: {port.problem}")


def _print_check(check: Check) -> None:
    out(f"{check.verdict:11} {check.name}: {check.message}")


def _as_json(found: Examination, ports: dict[str, list[Port]]) -> dict[str, Any]:
    info = None if found.info is None else asdict(found.info) | {"quantities": sorted(found.info.quantities)}
    if info is not None:
        info = {key: None if value != value else value for key, value in info.items()}  # noqa: PLR0124 - JSON has no NaN
    return {
        "schema": "hil-doctor/1",
        "ok": found.ok,
        "ports": {kind: [asdict(port) for port in listed] for kind, listed in ports.items()},
        "drive": info,
        "bus": None if found.bus is None else asdict(found.bus),
        "checks": [asdict(check) for check in found.checks],
    }
