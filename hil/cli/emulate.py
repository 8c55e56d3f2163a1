"""`hil emulate`: emulated drives that answer on a serial port or a CAN bus."""

from __future__ import annotations

import os
import select
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli import options
from hil.cli.terminal import out, say
from hil.errors import WrongUse, proposing

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from sim_backend.fault_plan import FaultPlan
    from sim_backend.parameters import SimParameters
    from sim_backend.wire.torque_log import TorqueLog


def emulate(
    name: Annotated[str | None, typer.Argument(help="The drive to emulate; without it, list them.")] = None,
    model: Annotated[str | None, typer.Option(help="The drive's model, where there are several.")] = None,
    firmware: Annotated[str | None, typer.Option(help="The drive's firmware, where there are several.")] = None,
    ident: Annotated[list[int] | None, typer.Option("--id", help="Its id on the bus; repeat it for several.")] = None,
    link: Annotated[Path | None, typer.Option(help="The serial port to create: a symlink to a pty.")] = None,
    bus: Annotated[str | None, typer.Option(help="slcan, damiao, robstride (at --link), udp_multicast, ...")] = None,
    channel: Annotated[str | None, typer.Option(help="The channel of --bus.")] = None,
    baudrate: Annotated[int | None, typer.Option(help="bit/s.")] = None,
    stand: options.StandFile = None,
    hand: Annotated[Path | None, typer.Option(help="The file of a hand: all its servos, with their plants.")] = None,
    log: Annotated[
        Path | None, typer.Option(help="A new CSV file of the torque at every moment, which survives a kill.")
    ] = None,
    faults: options.Faults = None,
    instant: Annotated[bool, typer.Option("--instant", help="Answer at once: the bytes take no time.")] = False,
    background: Annotated[
        bool, typer.Option("--background", help="Return as soon as the drive answers; print its process id.")
    ] = False,
) -> None:
    """Emulate a drive, or a hand's servos, on a port or bus until Ctrl-C, moving the simulated plant ([sim]).

    With --background it answers until it is killed by the id that is printed, or until the terminal is closed.

    Example: hil emulate dynamixel --link ./ttyDXL --log torque.csv
    """
    from sim_backend.wire.catalogue import EMULATORS, ended_by_signal, make, waking_in_time

    if background and not hasattr(os, "fork"):
        raise WrongUse("this system has no --background: start the emulator in another terminal")
    if name is None:
        for known, emulator in EMULATORS.items():
            out(f"{known:10} {emulator.noun} {emulator.where}")
        return
    words: dict[str, Any] = {"model": model, "idents": ident, "link": link, "bus": bus, "channel": channel}
    words |= {"firmware": firmware, "baudrate": baudrate, "instant": instant or None}
    words |= {"parameters": _plant(stand), "faults": _plan(faults)}
    words |= {} if hand is None else _hand(name, hand, words)
    given = {key: value for key, value in words.items() if value not in (None, [])}
    place = next((f" on {given[key]}" for key in ("link", "channel", "bus") if key in given), "")
    if log is not None:
        given["log"] = _torque_log(log)
    try:
        served = make(name, given)
    except ValueError as error:
        if log is not None:
            log.unlink()  # nothing was emulated
        raise WrongUse(proposing(str(error))) from None
    noun = EMULATORS[name].noun if hand is None else f"the {len(words['hand'])} servos of {hand}, each"
    what = f"Emulating {noun}{f' {model.upper()}' if model else ''}{place}."
    if background and (process := _copied(served.stop)) is not None:
        say(f"{what} It ends with this terminal, or with: kill {process}")
        out(str(process))
        os._exit(0)  # all that is open belongs to the copy now
    with ended_by_signal(served), waking_in_time():
        say(f"{what} Ctrl-C to stop.")
        served.serve()
    say("ended")


def _plant(stand: Path | None) -> SimParameters | None:
    from hil.stand.file import load

    return None if stand is None else load(stand).simulated()


def _hand(name: str, path: Path, words: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of an emulator with the servos of a hand. name: of the emulator. Raises WrongUse."""
    from hil.hand.file import load
    from sim_backend.wire.packets.servos import OnLine

    if extra := [key for key in ("model", "idents", "parameters", "baudrate") if words[key]]:
        named = {"idents": "id", "parameters": "stand"}
        raise WrongUse(f"--hand takes no --{named.get(extra[0], extra[0])}: {path} says it for each joint")
    servos, rates, joints = [], set(), load(path).joints
    idents = {one.name: getattr(one.stand.devices.get(name), "id", 0) for one in joints}
    for joint in joints:
        if joint.stand.stand.backend != name:
            raise WrongUse(f"joint {joint.name} of {path} is no {name}: its backend is {joint.stand.stand.backend}")
        table = joint.stand.devices[name]
        turns = {idents[other]: turn for other, turn in joint.stand.simulated_neighbours().items()}
        servos.append(OnLine(table.model, table.id, joint.stand.simulated(), turns))
        rates.add(table.baudrate)
    if len(rates) > 1:
        raise WrongUse(f"{path}: the servos on one line have one baud rate, not {', '.join(map(str, sorted(rates)))}")
    return {"hand": servos, "baudrate": rates.pop()}


def _plan(faults: Path | None) -> FaultPlan | None:
    from hil.stand.fault_file import load_plan

    return None if faults is None else load_plan(faults)


def _copied(stop: Callable[[], None]) -> int | None:
    """Fork this process. Return the id of the copy; in the copy, return None.

    The copy leaves the terminal and calls `stop` at its end.
    """
    session, own = os.getsid(0), os.getpid()
    if copy := os.fork():
        return copy
    os.setsid()
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in range(3):
        os.dup2(nothing, number)
    if session != own and hasattr(os, "pidfd_open"):  # macOS cannot wait for the end of a process like this
        threading.Thread(target=_wait_for_the_end, args=(session, stop), daemon=True).start()
    return None


def _wait_for_the_end(process: int, stop: Callable[[], None]) -> None:
    try:
        ended = os.pidfd_open(process)
    except ProcessLookupError:
        stop()
    except OSError:  # it belongs to others, or the kernel is too old
        return
    else:
        select.select([ended], [], [])
        stop()


def _torque_log(path: Path) -> TorqueLog:
    from sim_backend.wire.torque_log import TorqueLog

    try:
        return TorqueLog(path)
    except FileExistsError:
        raise WrongUse(f"{path} exists: choose another name with --log") from None
    except OSError as error:
        raise WrongUse(f"{path} cannot be written ({error.strerror}): choose another folder with --log") from None
