"""The catalogue of the emulators that `hil emulate` can start, one entry each.

An entry names a function that makes the emulator. The function has a parameter for each option of the command that it
accepts, named as below, and returns a `Served`. An option without a parameter is refused; a parameter without a default
is required. The text of an exception from the function is shown to the user.

    link: Path, or channel: str | Path           --link, --channel: a symlink to a pty; the channel of a CAN bus
    interface: str                               --bus: slcan (a pty at --link), udp_multicast, socketcan ...
    model: str, firmware: str                    --model, --firmware (means --model where there is no firmware)
    idents: Sequence[int], baudrate: int         --id, --baudrate (bit/s)
    parameters: SimParameters | None             --stand: its plant; None: the emulator's own
    hand: Sequence[OnLine]                       --hand: the servos of a hand, with their ids and plants
    log: TorqueLog | None                        --log
    faults: FaultPlan | None                     --faults
    timing: object | None                        --instant: None, no time passes; else what the entry's `timing` makes
"""

from __future__ import annotations

import gc
import inspect
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from types import MappingProxyType
from typing import Any, Protocol


class Served(Protocol):
    """An emulator that is ready to be served."""

    def serve(self) -> None:
        """Serve the emulator until `stop` is called, then release its ports and buses."""

    def stop(self) -> None:
        """Make `serve` return; may be called from a signal."""


@dataclass(frozen=True, slots=True)
class Emulator:
    """An entry of the catalogue: the device's name, where it appears (pty or CAN bus), and the function that makes it,
    as "module:name".

    timing: the class whose default object has the usual durations of the wire, as "module:name"; needed if the function
    has a parameter `timing`.
    """

    noun: str
    where: str
    place: str
    timing: str = ""

    def function(self) -> Callable[..., Served]:
        """Return the function that makes the emulator."""
        made: Callable[..., Served] = _named(self.place)
        return made


def _on_can(noun: str, family: str, bus: str = "CAN") -> Emulator:
    place = f"sim_backend.wire.can_families:{family}"
    return Emulator(noun, f"on {bus}: --link, or --bus", place, "sim_backend.wire.canbus.bus:CanTiming")


def _on_a_pty(noun: str, family: str, timing: str = "") -> Emulator:
    return Emulator(noun, "on a pty: --link", f"sim_backend.wire.{family}.emulator:serve", timing)


_PACKETS = "sim_backend.wire.packets.bus:PacketTiming"

EMULATORS: Mapping[str, Emulator] = MappingProxyType(
    {
        "dynamixel": _on_a_pty("a DYNAMIXEL", "dynamixel", _PACKETS),
        "feetech": _on_a_pty("a Feetech servo", "feetech", _PACKETS),
        "odrive": _on_can("an ODrive", "odrive"),
        "mit": _on_can("a CubeMars AK or Damiao motor", "mit"),
        "robstride": _on_can("a RobStride motor", "robstride"),
        "moteus": _on_can("a moteus", "moteus", "CAN FD"),
        "cia402": _on_can("a CiA 402 drive", "cia402"),
        "commander": _on_a_pty("a SimpleFOC board", "commander", "sim_backend.wire.commander.emulator:CommanderTiming"),
        "loadcell": _on_a_pty("a torque cell", "loadcell"),
    }
)


def make(name: str, options: Mapping[str, Any]) -> Served:
    """Return the emulator `name`. options: values by the names in this module's docstring.

    Raises ValueError for an unknown name, an option that the emulator does not accept, a missing option, or a refused
    value.
    """
    if name not in EMULATORS:
        near = get_close_matches(name, EMULATORS, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"unknown emulator {name!r}: {hint}known are {', '.join(EMULATORS)}")
    emulator = EMULATORS[name]
    function = emulator.function()
    takes = inspect.signature(function).parameters
    words = {_parameter(option, takes): value for option, value in options.items()}
    for option in options:
        if (meant := _parameter(option, takes)) != option and meant in options:
            raise ValueError(f"hil emulate {name}: --{option} means --{meant} here: give one of the two")
    if "timing" in takes and not words.pop("instant", False):
        words["timing"] = _named(emulator.timing)()
    extra = [_option(word) for word in words if word not in takes]
    if extra:
        raise ValueError(f"hil emulate {name} takes no {', '.join(extra)}: it takes {_listed(takes)}")
    needed = [word for word, taken in takes.items() if taken.default is taken.empty and word not in words]
    if needed:
        raise ValueError(f"hil emulate {name} needs {_listed(needed)}")
    try:
        return function(**words)
    except OSError as error:
        place = next((f" on {words[key]}" for key in ("link", "channel", "bus") if words.get(key)), "")
        raise ValueError(f"hil emulate {name}{place}: {error.strerror or error}") from error
    except Exception as error:
        raise ValueError(f"hil emulate {name}: {error}") from error


def _parameter(option: str, takes: Mapping[str, inspect.Parameter]) -> str:
    """Return the name of the parameter that receives an option. takes: the parameters of the emulator's function."""
    if option == "bus":
        return "interface"
    other = {"link": "channel", "firmware": "model"}.get(option, option)
    return other if option not in takes and other in takes else option


@contextmanager
def waking_in_time() -> Iterator[None]:
    """Context manager that makes this thread wake up sooner: higher priority, if the system permits it (root, or
    `ulimit -r`), and shorter pauses for garbage collection.

    On a busy computer a sleeping process may wait many ms for its turn. Clients do not wait so long: rustypot's scan
    waits 5 ms for a reply, which a real servo meets. The emulators sleep most of the time. Garbage collection skips the
    objects that exist already; otherwise one collection would take 28 ms.
    """
    gc.freeze()
    try:
        with _soon():
            yield
    finally:
        gc.unfreeze()


@contextmanager
def _soon() -> Iterator[None]:
    scheduler = getattr(os, "sched_setscheduler", None)  # Linux has it
    if scheduler is None:
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        scheduler(0, os.SCHED_RR, os.sched_param(1))
    try:
        yield
    finally:
        with suppress(OSError):
            scheduler(0, *before)


@contextmanager
def ended_by_signal(served: Served) -> Iterator[None]:
    """Context manager: Ctrl-C, a kill or a closed terminal call `served.stop`."""
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
