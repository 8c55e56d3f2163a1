"""The live view of a run, drawn by a separate process that maps the `.part` file and reads its valid rows.

Drawing in the control process costs every fifth tick at 1 kHz; drawing in a separate process costs none. The viewer
ends when its standard input ends, because the recorder has closed it or has ended. A key asks the recorder to stop by a
signal, like Ctrl-C.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hil.child import command
from hil.live.screen import drawn
from hil.live.state import State
from hil.recording.channels import Rows

_REFRESH = 0.2  # s
_SLOW_SCREEN = 10  # of niceness: the control loop comes first


@contextmanager
def beside(part: Path, rerun: str = "") -> Iterator[None]:
    """While the block runs, show the recording at `part` in a separate viewer process, if standard error is a terminal.

    rerun: "window" or a file .rrd, in which Rerun shows the run as well; "" for neither. The viewer has a session of
    its own, so that Ctrl-C does not reach it. If the viewer cannot be started, the run continues without it.
    """
    if not (sys.stderr.isatty() or rerun):
        yield
        return
    with _terminal_kept() as terminal:
        try:
            encoding = getattr(sys.stderr, "encoding", None) or "ascii"
            words = command("hil.live.viewer", str(part), str(terminal), str(os.getpid()), encoding, rerun)
            passed = () if terminal < 0 else (terminal,)
            viewer = subprocess.Popen(  # noqa: S603 - our own module
                words, stdin=subprocess.PIPE, start_new_session=True, pass_fds=passed
            )
        except OSError:
            yield
            return
        try:
            yield
        finally:
            with suppress(Exception):  # a fault of the viewer must not end the run
                viewer.communicate(timeout=5.0)
            with suppress(Exception):
                viewer.kill()
                viewer.wait()


@contextmanager
def _terminal_kept() -> Iterator[int]:
    """Yield a file descriptor of the terminal from which keys are read, -1 if there is no terminal. Afterwards restore
    the terminal's settings.
    """
    try:
        import termios

        terminal = os.dup(sys.stdin.fileno())
    except (ImportError, OSError, ValueError, AttributeError):
        yield -1
        return
    try:
        before = termios.tcgetattr(terminal) if os.isatty(terminal) and sys.stderr.isatty() else None
        yield terminal if before is not None else -1
        if before is not None:
            with suppress(termios.error):
                termios.tcsetattr(terminal, termios.TCSADRAIN, before)
    finally:
        os.close(terminal)


def watch(path: Path, terminal: int, recorder: int, encoding: str, rerun: str) -> None:
    """Show the recording in progress at `path` until standard input ends.

    terminal: file descriptor from which keys are read, or -1. recorder: id of the process that a key stops. encoding:
    of the terminal. rerun: "window", a file .rrd, or "".
    """
    with suppress(OSError):
        os.nice(_SLOW_SCREEN)
    state = State(*opened(path))
    ended = threading.Event()
    threading.Thread(target=_wait_for_end, args=(ended,), daemon=True).start()
    shown: list[Callable[[State], object]] = []
    if rerun:
        from hil.live.rerun import Stream

        with suppress(Exception):  # the terminal goes on without it
            shown.append(Stream(rerun).update)
    with _keys(terminal, recorder) as has_keys, _screen(has_keys=has_keys, encoding=encoding) as screen:
        while not ended.wait(_REFRESH):
            state.update()
            for show in (screen, *shown):
                show(state)
        state.update()
        for show in shown:
            show(state)


def opened(path: Path) -> tuple[Rows, float, Mapping[str, float]]:
    """Return three things about a recording in progress: its rows, its planned duration, s, and its limits, SI at the
    joint.
    """
    with h5py.File(path, "r") as file:
        offset, length, layout = int(file["live"].id.get_offset()), len(file["live"]), file["live"].dtype
        duration = float(file["profile"].attrs["duration"])
        text = str(file.attrs.get("stand_toml", ""))
    rows: Rows = np.memmap(path, dtype=layout, mode="r", offset=offset, shape=(length,))
    return rows, duration, _limits(text)


def _limits(text: str) -> dict[str, float]:
    with suppress(Exception):  # a view without limits is better than none
        from hil.stand.file import parse

        table = parse(text).limits
        return {} if table is None else {name: float(value) for name, value in table.model_dump().items()}
    return {}


@contextmanager
def _screen(*, has_keys: bool, encoding: str) -> Iterator[Callable[[State], object]]:
    """Yield a function that draws a state on standard error. If standard error is no terminal, the function does
    nothing. has_keys: whether keys are read. encoding: of the terminal.
    """
    if not sys.stderr.isatty():
        yield lambda _state: None
        return
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(stderr=True)
    unicode = encoding.lower().startswith("utf")
    with Live(console=console, auto_refresh=False, transient=True) as live:

        def draw(state: State) -> None:
            text = drawn(state, console.width, console.height, unicode=unicode, keys=has_keys)
            live.update(Text(text, no_wrap=True, overflow="crop"), refresh=True)

        yield draw


@contextmanager
def _keys(terminal: int, recorder: int) -> Iterator[bool]:
    """While the block runs, read keys from a terminal. Yield whether keys can be read.

    Space or q asks the recorder to ramp the torque down and stop; a second q stops the recorder at once.
    """
    try:
        import termios
        import tty

        before: Any = termios.tcgetattr(terminal)
        tty.setcbreak(terminal, termios.TCSADRAIN)
    except Exception:  # noqa: BLE001 - no terminal: no keys
        yield False
        return
    threading.Thread(target=_read_keys, args=(terminal, recorder), daemon=True).start()
    try:
        yield True
    finally:
        with suppress(termios.error):
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _read_keys(terminal: int, recorder: int) -> None:
    asked = False
    with suppress(OSError):
        while select.select([terminal], [], [])[0]:
            key = os.read(terminal, 1)
            if not key:
                return
            if (key == b" " and not asked) or key in {b"q", b"Q"}:
                asked = True
                if os.getppid() == recorder:  # it is still there, and the number is its own
                    os.kill(recorder, signal.SIGINT)


def _wait_for_end(ended: threading.Event) -> None:
    sys.stdin.buffer.read()
    ended.set()


if __name__ == "__main__":
    watch(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4], sys.argv[5])
