"""`hil doctor`: check ports, CAN interfaces and the drive of a stand."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivers.servo import DriverError, Quantity
from hil.cli import options
from hil.cli.terminal import (
    DONE,
    STAND_FAILED,
    UNTRUSTWORTHY,
    WRONG_USE,
    ask_to_go_on,
    asking,
    note,
    out,
    print_json,
    say,
)
from hil.errors import Declined, Untrustworthy, WrongUse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from drivers.ports import Port
    from hil.doctor.checks import Check, CheckList
    from hil.doctor.commission import Report
    from hil.hand.file import Hand
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
    until that has been done, and again after 30 days (docs/reliability.md). With the file of a hand and no --joint, all
    joints are checked one after the other.
    """
    from drivers.ports import can_interfaces, serial_ports
    from hil.doctor.checks import CheckList
    from hil.hand.file import load, load_stand

    jog = options.amplitude_of(amplitude, mode)
    if jog is not None and not jog > 0.0:
        raise WrongUse(f"--amplitude {jog:g}: it must be above 0")
    wanted = _Wanted(mode, rate, jog, move=move, tune=tune, commission=commission, yes=yes)
    if stand is not None and joint is None and _is_hand(stand):
        raise typer.Exit(_check_hand(load(stand), wanted, as_json=as_json))
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
            report = wanted.examined(checks, opened)
    finally:
        if commission and not as_json:
            _print_commissioning(checks, report)
    if as_json:
        listed = {kind: [asdict(port) for port in found] for kind, found in (("serial", ports), ("can", interfaces))}
        print_json({"schema": "hil-doctor/2", "ports": listed} | _as_json(checks, report))
    raise typer.Exit(_status(checks, report))


@dataclass(frozen=True, slots=True)
class _Wanted:
    """The options that say what is checked of a drive. amplitude: of the jog, N m or rad at the joint."""

    mode: Quantity
    rate: float
    amplitude: float | None
    move: bool
    tune: bool
    commission: bool
    yes: bool

    def examined(self, checks: CheckList, stand: Stand, **more: Any) -> Report | None:
        """Make the checks of one stand. more: further arguments of `examine`."""
        from hil.doctor.examine import examine

        return examine(
            checks,
            stand,
            self.mode,
            rate=self.rate,
            move=self.move,
            amplitude=self.amplitude,
            tuned=self.tune,
            say=say if self.commission else None,
            agree=asking(yes=self.yes or self.commission),
            **more,
        )


def _is_hand(path: Path) -> bool:
    from hil.hand.file import is_hand
    from hil.recording.input import read_text
    from hil.stand.file import LARGEST

    return is_hand(read_text(path, largest=LARGEST))


def _check_hand(hand: Hand, wanted: _Wanted, *, as_json: bool) -> int:
    """Check the joints of a hand one after the other, print a line for each, and return the worst exit status.

    A joint's failure ends only its own checks; a signal, or a torque that may still be on, ends all.
    """
    from hil.doctor.checks import CheckList

    search = _searching_once()
    statuses: dict[str, int] = {}
    shown: dict[tuple[str, str], str] = {}
    tables: dict[str, dict[str, Any]] = {}
    seconds = 0.0
    for at, joint in enumerate(hand.joints, 1):
        checks, report, status = CheckList(on_alarm=say), None, DONE
        began = time.monotonic()
        try:
            if wanted.commission:
                _confirm(joint.stand, yes=wanted.yes)
                began = time.monotonic()  # the person's answer takes no part in the estimate
            report = wanted.examined(checks, joint.stand, search=search)
        except Declined:
            raise
        except (WrongUse, Untrustworthy, DriverError) as error:
            checks.failed("stand", str(error))
            status = UNTRUSTWORTHY if isinstance(error, Untrustworthy) else WRONG_USE * isinstance(error, WrongUse)
        seconds += time.monotonic() - began
        is_live = any(check.name == "torque off" for check in checks.checks)
        statuses[joint.name] = STAND_FAILED if is_live else status or _status(checks, report)
        if as_json:
            tables[joint.name] = _as_json(checks, report)
        else:
            _print_joint(joint.name, checks, report, shown)
        if checks.signal or is_live:
            break
        if left := len(hand.joints) - at:
            note(f"{at} of {len(hand.joints)} joints; about {seconds / at * left / 60.0:.1f} min left")
    if as_json:
        print_json({"schema": "hil-doctor-hand/1", "ok": not any(statuses.values()), "joints": tables})
    else:
        out(_hand_summary(hand, statuses))
    return max(statuses.values())


def _hand_summary(hand: Hand, statuses: Mapping[str, int]) -> str:
    wrong = [name for name, status in statuses.items() if status]
    left = [joint.name for joint in hand.joints if joint.name not in statuses]
    said = f"{len(statuses) - len(wrong)} of {len(hand.joints)} joints passed"
    said += f"; wrong: {', '.join(wrong)}" if wrong else ""
    return said + (f"; not checked: {', '.join(left)}" if left else "")


def _print_joint(name: str, checks: CheckList, report: Report | None, shown: dict[tuple[str, str], str]) -> None:
    """Print one line for a joint, and below it what is wrong. shown: what was printed before, with its joint, to print
    nothing twice.
    """
    from hil.doctor.checks import called

    info = checks.info
    words = [] if info is None else [called(info)]
    if report is not None:
        words.append(f"commissioned until {report.outcome.until}" if report.good else report.verdict)
    out(f"{checks.verdict:11} {name}: {', '.join(words) or 'it was not reached'}")
    for check in checks.checks:
        if check.verdict in {"warning", "error"}:
            first = shown.setdefault((check.name, check.message), name)
            if first == name or check.verdict == "error":
                out(f"{'':11}   {check.name}: {check.message if first == name else f'as with {first}'}")


def _searching_once() -> Callable[[str, Any], list[str]]:
    """Return the search for drives on the link of one that does not answer, which searches each link once."""
    from hil.stand.devices import found_by_search

    found: dict[tuple[object, ...], list[str]] = {}

    def search(backend: str, table: Any) -> list[str]:
        link = (backend, *(getattr(table, key, None) for key in ("port", "interface", "channel")))
        if link not in found:
            found[link] = found_by_search(backend, table)
        return found[link]

    return search


def _status(checks: CheckList, report: Report | None) -> int:
    """Return the exit status that follows from the checks of a drive."""
    if checks.signal:
        return 128 + checks.signal
    if report is not None and not report.good:
        return UNTRUSTWORTHY
    return DONE if checks.ok else STAND_FAILED


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


def _as_json(checks: CheckList, report: Report | None) -> dict[str, Any]:
    info = None if checks.info is None else asdict(checks.info) | {"quantities": sorted(checks.info.quantities)}
    if info is not None:
        info = {
            key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in info.items()
        }
    return {
        "ok": checks.ok,
        "drive": info,
        "bus": None if checks.bus is None else asdict(checks.bus),
        "commissioning": None if report is None else report.as_json(),
        "checks": [asdict(check) for check in checks.checks],
    }
