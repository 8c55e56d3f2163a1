"""`hil emulate`: drives that answer on a wire and are not there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hil.cli.terminal import out, say
from hil.errors import WrongUse


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
    from sim_backend.wire.catalogue import EMULATORS, ended_by_signal, make

    if name is None:
        for known, emulator in EMULATORS.items():
            out(f"{known:10} {emulator.explanation}")
        return
    words: dict[str, Any] = {"model": model, "idents": ident, "link": link, "bus": bus, "channel": channel}
    words |= {"firmware": firmware, "baudrate": baudrate, "instant": instant or None}
    given = {key: value for key, value in words.items() if value not in (None, [])}
    described = ", ".join(f"{key} {value}" for key, value in given.items())
    if stand is not None:
        from hil.stand.file import load

        given["parameters"] = load(stand).simulated()
    try:
        served = make(name, given)
    except ValueError as error:
        raise WrongUse(str(error)) from None
    with ended_by_signal(served):
        say(f"{name} is there ({described}); Ctrl-C ends it")
        served.serve()
    say("ended")
