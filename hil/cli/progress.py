"""How far a long command is: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hil.cli.terminal import say

_QUIET = 10.0  # s without a line, in which nobody yet wonders


@contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """What is told what is being done and the part of it that is done, 0 to 1, and shows it with the time left.

    On a terminal a bar, gone at the end; elsewhere a line on standard error for every tenth of what takes long.
    """
    if not sys.stderr.isatty():
        yield Lines()
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def show(what: str, done: float) -> None:
            if what != bar.tasks[0].description or done < bar.tasks[0].completed:
                bar.reset(task, description=what)  # the next thing: its time left is its own
            bar.update(task, completed=done)

        yield show


class Lines:
    """A line for every tenth that is done, but none within `_QUIET` of the one before. now: a clock, s."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._what, self._tenths, self._first = "", 0, 0.0
        self._began = self._said = now()

    def __call__(self, what: str, done: float) -> None:
        """Say how far `what` is, if it is time to."""
        now, tenths = self._now(), int(10.0 * done)
        if what != self._what or tenths < self._tenths:
            self._what, self._tenths, self._first, self._began = what, tenths, done, now
        if tenths == self._tenths or now - self._said < _QUIET:
            return
        self._tenths, self._said = tenths, now
        left = (now - self._began) * (1.0 - done) / (done - self._first)
        say(f"{what}: {done:.0%} done, about {left:.0f} s left")
