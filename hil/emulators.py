"""The emulated peers of `hil emulate`: one line each.

The function behind a line takes what it needs of the options below, by these names, and returns a `Served`; an option
it has no parameter for is refused, and one without a default must be given. It raises ValueError or FileExistsError
with a sentence for a person.

    link: Path (a symlink to a pty)     bus: str (slcan, udp_multicast)     channel: str (of that bus)
    model: str      idents: Sequence[int]      baudrate: int, bit/s
    parameters: SimParameters | None (the plant; None: the peer's own)      instant: bool (no time passes on the wire)
"""

from __future__ import annotations

import inspect
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from types import MappingProxyType
from typing import Any, Protocol

from hil.errors import WrongUse


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
    """A line: what a person is told of it, and where the function is, as "module:name"."""

    explanation: str
    place: str

    def function(self) -> Callable[..., Served]:
        """The function that makes it."""
        module, name = self.place.split(":")
        made: Callable[..., Served] = getattr(import_module(module), name)
        return made


EMULATORS: Mapping[str, Emulator] = MappingProxyType(
    {
        "dynamixel": Emulator("DYNAMIXEL servos on a pty: --link", "sim_backend.wire.dynamixel:emulate"),
    }
)


def make(name: str, options: Mapping[str, Any]) -> Served:
    """The emulator `name` with the options that were given, by the names of this module's docstring.

    Raises WrongUse for an unknown name, an option it does not take, one it needs, or a value it refuses.
    """
    if name not in EMULATORS:
        near = get_close_matches(name, EMULATORS, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise WrongUse(f"unknown emulator {name!r}: {hint}known are {', '.join(EMULATORS)}")
    function = EMULATORS[name].function()
    takes = inspect.signature(function).parameters
    extra = [_option(option) for option in options if option not in takes]
    if extra:
        raise WrongUse(f"hil emulate {name} takes no {', '.join(extra)}: it takes {_listed(list(takes))}")
    needed = [word for word, taken in takes.items() if taken.default is taken.empty and word not in options]
    if needed:
        raise WrongUse(f"hil emulate {name} needs {_listed(needed)}")
    try:
        return function(**options)
    except (ValueError, FileExistsError) as error:
        raise WrongUse(str(error)) from None


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
    return {"idents": "--id", "parameters": "--stand"}.get(name, f"--{name}")


def _listed(names: list[str]) -> str:
    return ", ".join(_option(name) for name in names)
