"""The status line of a run, drawn by a process of its own that maps the `.part` file and reads its valid rows.

Drawing in the control process costs every fifth tick at 1 kHz; drawing here costs none. The process ends with its
standard input, when the recorder closes it or is gone.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
import numpy as np

from drivers.servo import Status
from hil.child import command
from hil.recording.channels import Rows

_REFRESH = 0.1  # s


@contextmanager
def beside(part: Path) -> Iterator[None]:
    """Watch the recording at `part` from a process of its own, where standard error is a terminal.

    The viewer is in a session of its own, which Ctrl-C does not reach. A run goes on without a viewer that cannot be
    started.
    """
    if not sys.stderr.isatty():
        yield
        return
    try:
        words = command("hil.acquisition.live_view", str(part))
        viewer = subprocess.Popen(words, stdin=subprocess.PIPE, start_new_session=True)  # noqa: S603 - our own module
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


def watch(path: Path) -> None:
    """Draw the line for the recording in progress at `path` until standard input ends."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    with h5py.File(path, "r") as file:
        offset, length, layout = int(file["live"].id.get_offset()), len(file["live"]), file["live"].dtype
        duration = float(file["profile"].attrs["duration"])
    rows: Rows = np.memmap(path, dtype=layout, mode="r", offset=offset, shape=(length,))
    ended = threading.Event()
    threading.Thread(target=_wait_for_end, args=(ended,), daemon=True).start()
    console = Console(stderr=True)
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while not ended.wait(_REFRESH):
            live.update(Text(line(rows, duration), no_wrap=True, overflow="crop"), refresh=True)


def _wait_for_end(ended: threading.Event) -> None:
    sys.stdin.buffer.read()
    ended.set()


def line(rows: Rows, duration: float) -> str:
    """Return the state of a run of `duration` s: time left, rate, torque, deflection, lost samples."""
    count = _written(rows)
    if count < 2:
        return "starting"
    done = rows[:count]
    last = done[-1]
    recent = done[max(0, count - 200) :]["time"]
    elapsed = float(np.nanmax(recent))
    rate = (len(recent) - 1) / (elapsed - float(np.nanmin(recent)))
    lost = int(np.count_nonzero(done["status"] & np.uint64(int(Status.NO_REPLY | Status.BAD_REPLY))))
    torque = float(last["torque"])
    shown = f"{torque:+7.2f} N m" if abs(torque) >= 1.0 else f"{torque * 1e3:+7.2f} mN m"
    return (
        f"{max(0.0, duration - elapsed):6.1f} s left  {rate:5.0f} Hz  "
        f"torque {shown} at {float(last['dtheta']):+7.4f} rad  {lost} lost"
    )


def _written(rows: Rows) -> int:
    """Return the number of rows whose `seq` is their index, by bisection: they are written in order."""
    low, high = 0, len(rows)
    while low < high:
        middle = (low + high) // 2
        if rows["seq"][middle] == middle:
            low = middle + 1
        else:
            high = middle
    return low


if __name__ == "__main__":
    watch(Path(sys.argv[1]))
