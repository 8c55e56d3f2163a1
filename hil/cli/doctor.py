"""`hil doctor`: check ports, CAN interfaces and the drive of a stand."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivers.servo import Quantity
from hil.cli import options
from hil.cli.terminal import STAND_FAILED, UNTRUSTWORTHY, ask_to_go_on, asking, out, print_json, say
from hil.errors import WrongUse

if TYPE_CHECKING:
    from drivers.ports import Port
    from hil.doctor.checks import Check, CheckList
    from hil.doctor.commission import Report
    from hil.stand.file import Stand


def doctor(
    stand: Annotated[Path | None, typer.Argument(help="The stand file; without it: ports and interfaces.")] = None,
    joint: options.Joint = None,
    move: Annotated[bool, typer.Option("--move", help="Jog the motor to check the signs and the lock.")] = False,
    amplitude: Annotated[
        str | None,
        typer.Option(metavar="NUMBER", help="For --move: N m or rad at the joint, or with a unit [default: limit/20]."),
    ] = None,
    mode: options.Mode = Quantity.TORQUE,
    rate: Annotated[float, typer.Option(min=1.0, max=10_000.0, help="Hz to reach.")] = options.DEFAULT_RATE,
    tune: Annotated[
        bool, typer.Option("--tune", help="Find the highest rate at which 99.9 % of the replies are in time.")
    ] = False,
    commission: Annotated[
        bool,
        typer.Option("--commission", help="Test under 10 % of the torque limit that the drive releases its torque."),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before the motor moves.")] = False,
    as_json: options.Json = False,
) -> None:
    """Check ports and CAN interfaces, and with a stand file also the drive; say how to mend what is wrong.

    The drive is connected, read for a second, armed at zero torque and stopped again. --commission then drives it at 10
    % of its torque limit and takes its commands away, up to a second long; hil record keeps to half the torque limit
    until that has been done, and again after 30 days (docs/reliability.md).
    """
    from drivers.ports import can_interfaces, serial_ports
    from hil.doctor.checks import CheckList
    from hil.doctor.examine import examine
    from hil.hand.file import load_stand

    jog = options.amplitude_of(amplitude, mode)
    if jog is not None and not jog > 0.0:
        raise WrongUse(f"--amplitude {jog:g}: it must be above 0")
    opened = None if stand is None else load_stand(stand, joint)
    ports, interfaces = serial_ports(), can_interfaces()
    checks = CheckList(on_alarm=say)
    if commission:
        _confirm(opened, yes=yes)
    if not as_json:
        if opened is None:
            out(_summary(ports, interfaces))
            _print_ports("serial port", ports)
            _print_ports("CAN interface", interfaces)
        if not commission:
            checks.on_check = _print_check
    report = None
    try:
        if opened is not None:
            words = say if commission else None
            agree = asking(yes=yes or commission)
            report = examine(
                checks, opened, mode, rate=rate, move=move, amplitude=jog, tuned=tune, say=words, agree=agree
            )
    finally:
        if commission and not as_json:
            _print_commissioning(checks, report)
    if as_json:
        print_json(_as_json(checks, {"serial": ports, "can": interfaces}, report))
    _end(checks, report)


def _end(checks: CheckList, report: Report | None) -> None:
    if checks.signal:
        raise typer.Exit(128 + checks.signal)
    if report is not None and not report.good:
        raise typer.Exit(UNTRUSTWORTHY)
    if not checks.ok:
        raise typer.Exit(STAND_FAILED)


def _confirm(stand: Stand | None, *, yes: bool) -> None:
    """Print what will happen, and wait for a yes. Raises WrongUse without a stand, or if the answer is not yes."""
    if stand is None:
        raise WrongUse("--commission tries the drive of a stand: hil doctor stand.toml --commission")
    from hil.acquisition.commissioning import announcement

    motion = (
        f"will pull at up to {0.1 * stand.checked_limits().torque:.3g} N m (10 % of the torque limit) three times, for "
        "about a second each, and the drive gets no commands for up to a second of it."
    )
    (say if yes else ask_to_go_on)(announcement(stand, motion))


def _print_commissioning(checks: CheckList, report: Report | None) -> None:
    """Print the result of commissioning, then the checks."""
    failed = next((one for one in checks.checks if one.verdict == "error"), None)
    alarm = next((one.message for one in checks.checks if one.name == "torque off" and one is failed), "")
    if alarm:
        out(alarm)
    elif report is not None:
        out(report.verdict)
    elif failed is not None:
        out(f"not commissioned: {failed.name}: {failed.message}")
    for check in checks.checks:
        _print_check(check)


def _summary(ports: list[Port], interfaces: list[Port]) -> str:
    """Return one line: the ports and interfaces found, and whether they have a problem."""
    wrong = sum(bool(port.problem) for port in (*ports, *interfaces))
    seen = f"{len(ports)} serial port(s), {len(interfaces)} CAN interface(s)"
    if wrong:
        return f"{seen}: {wrong} cannot be used"
    if not (ports or interfaces):
        return f"nothing is wrong: {seen} are connected; the simulated servo needs none (hil demo)"
    return f"nothing is wrong: {seen}; look at a drive with: hil doctor stand.toml"


def _print_ports(kind: str, ports: list[Port]) -> None:
    for port in ports:
        out(f"{kind} {port.name}" + (f" ({port.described})" if port.described else ""))
        if port.problem:
            out(f"    problem: {port.problem}")


def _print_check(check: Check) -> None:
    out(f"{check.verdict:11} {check.name}: {check.message}")


def _as_json(checks: CheckList, ports: dict[str, list[Port]], report: Report | None) -> dict[str, Any]:
    info = None if checks.info is None else asdict(checks.info) | {"quantities": sorted(checks.info.quantities)}
    if info is not None:
        info = {
            key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in info.items()
        }
    return {
        "schema": "hil-doctor/2",
        "ok": checks.ok,
        "ports": {kind: [asdict(port) for port in listed] for kind, listed in ports.items()},
        "drive": info,
        "bus": None if checks.bus is None else asdict(checks.bus),
        "commissioning": None if report is None else report.as_json(),
        "checks": [asdict(check) for check in checks.checks],
    }
