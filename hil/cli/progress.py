"""Progress of a long command: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hil.cli.terminal import printable, say

_QUIET = 10.0  # s between two lines


@contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that shows a phase by name, the share of it that is done, 0 to 1, and the time left.

    On a terminal as a bar that is removed at the end; elsewhere as a line on standard error for every tenth.
    """
    if not sys.stderr.isatty():
        yield Lines()
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def show(what: str, done: float) -> None:
            what = printable(what)
            if what != bar.tasks[0].description or done < bar.tasks[0].completed:
                bar.reset(task, description=what)  # a new phase has its own time left
            bar.update(task, completed=done)

        yield show


class Lines:
    """Prints a line for every tenth that is done, at most one in `_QUIET`. now: a clock, s."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._what, self._tenths, self._first = "", 0, 0.0
        self._began = self._said = now()

    def __call__(self, what: str, done: float) -> None:
        """Print the progress of the phase `what`, if a line is due."""
        now, tenths = self._now(), int(10.0 * done)
        if what != self._what or tenths < self._tenths:
            self._what, self._tenths, self._first, self._began = what, tenths, done, now
        if tenths == self._tenths or now - self._said < _QUIET:
            return
        self._tenths, self._said = tenths, now
        left = (now - self._began) * (1.0 - done) / (done - self._first)
        say(f"{what}: {done:.0%} done, about {left:.0f} s left")
