"""The emulated peers of `hil emulate`: one line each.

The function behind a line takes what it needs of the command's options, by these names, and returns a `Served`; an
option it has no parameter for is refused, and one without a default must be given. What it raises is told to a person.

    link: Path, or channel: str | Path           --link, --channel: a symlink to a pty; the channel of a CAN bus
    interface: str                               --bus: slcan (a pty at --link), udp_multicast, socketcan ...
    model: str, firmware: str                    --model, --firmware
    idents: Sequence[int], baudrate: int         --id, --baudrate (bit/s)
    parameters: SimParameters | None             --stand: its plant; None: the peer's own
    instant: bool, or timing: object | None      --instant: no time passes; else what the line's `timing` makes
"""

from __future__ import annotations

import inspect
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from types import MappingProxyType
from typing import Any, Protocol


class Served(Protocol):
    """A peer that is ready to answer."""

    def serve(self) -> None:
        """Answer until `stop` is called, then clean up."""
        ...

    def stop(self) -> None:
        """Let `serve` return; may be called from a signal."""
        ...


@dataclass(frozen=True, slots=True)
class Emulator:
    """A line: what a person is told of it, and where the function is, as "module:name".

    timing: where the class is whose default is the usual wire, for a function with a parameter `timing`.
    """

    explanation: str
    place: str
    timing: str = ""

    def function(self) -> Callable[..., Served]:
        """The function that makes it."""
        made: Callable[..., Served] = _named(self.place)
        return made


_CAN_TIMING = "sim_backend.wire.canbus.bus:CanTiming"

EMULATORS: Mapping[str, Emulator] = MappingProxyType(
    {
        "dynamixel": Emulator("DYNAMIXEL servos on a pty: --link", "sim_backend.wire.dynamixel.emulator:emulate"),
        "odrive": Emulator(
            "ODrive axes on CAN: --link, or --bus", "sim_backend.wire.odrive.emulator:serve", _CAN_TIMING
        ),
        "mit": Emulator(
            "CubeMars AK, Damiao on CAN: --link, or --bus", "sim_backend.wire.mit.emulator:serve", _CAN_TIMING
        ),
        "moteus": Emulator("moteus on CAN FD: --link, or --bus", "sim_backend.wire.moteus.emulator:serve", _CAN_TIMING),
        "cia402": Emulator(
            "CiA 402 drives on CAN: --link, or --bus", "sim_backend.wire.cia402.emulator:serve", _CAN_TIMING
        ),
        "commander": Emulator("a SimpleFOC board on a pty: --link", "sim_backend.wire.commander.emulator:emulate"),
        "loadcell": Emulator(
            "a torque cell that prints its readings on a pty: --link", "sim_backend.wire.loadcell.emulator:emulate"
        ),
    }
)


def make(name: str, options: Mapping[str, Any]) -> Served:
    """The emulator `name` with the options that were given, by the names of this module's docstring.

    Raises ValueError for an unknown name, an option it does not take, one it needs, or a value it refuses.
    """
    if name not in EMULATORS:
        near = get_close_matches(name, EMULATORS, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"unknown emulator {name!r}: {hint}known are {', '.join(EMULATORS)}")
    emulator = EMULATORS[name]
    function = emulator.function()
    takes = inspect.signature(function).parameters
    words = {_parameter(option, takes): value for option, value in options.items()}
    if "timing" in takes and emulator.timing and not words.pop("instant", False):
        words["timing"] = _named(emulator.timing)()
    extra = [_option(word) for word in words if word not in takes]
    if extra:
        raise ValueError(f"hil emulate {name} takes no {', '.join(extra)}: it takes {_listed(takes)}")
    needed = [word for word, taken in takes.items() if taken.default is taken.empty and word not in words]
    if needed:
        raise ValueError(f"hil emulate {name} needs {_listed(needed)}")
    try:
        return function(**words)
    except Exception as error:
        raise ValueError(f"hil emulate {name}: {error}") from error


def _parameter(option: str, takes: Mapping[str, inspect.Parameter]) -> str:
    """The parameter that an option goes to."""
    if option == "bus":
        return "interface"
    return "channel" if option == "link" and "link" not in takes else option


@contextmanager
def ended_by_signal(served: Served) -> Iterator[None]:
    """Let Ctrl-C, a kill or a closed terminal stop `served`."""
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
    before = {name: signal.signal(getattr(signal, name), lambda *_: served.stop()) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def _option(name: str) -> str:
    known = {"idents": "--id", "parameters": "--stand", "interface": "--bus", "timing": "--instant"}
    return known.get(name, "--link (or --channel)" if name == "channel" else f"--{name}")


def _listed(names: Iterable[str]) -> str:
    return ", ".join(_option(name) for name in names)


def _named(place: str) -> Any:
    module, name = place.split(":")
    return getattr(import_module(module), name)
