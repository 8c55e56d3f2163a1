"""Progress of a long command: a bar on a terminal; otherwise a line of text from time to time."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ga.first_run import announced_to
from hil.cli.terminal import is_quiet, say
from hil.printable import printable

Show = Callable[[str, float], None]
_QUIET = 10.0  # s between two lines
_LONG = 60.0  # s after which a line is due though no tenth is done


@contextmanager
def progress() -> Iterator[Show]:
    """Yield a function that shows the name of a phase, its completed fraction, 0 to 1, and the time left.

    On a terminal this is a bar, which is removed at the end. Otherwise it is a line on standard error for every
    completed tenth. If the fraction is unknown (NaN), the bar has no end, and a line is printed at once and every ten
    seconds. During the first run the compilation of the search is shown in the same way.
    """
    with _shown() as show, announced_to(_Compiling(show)):
        yield show


class _Compiling:
    """Shows how many functions have been compiled so far."""

    def __init__(self, show: Show) -> None:
        self._show, self._count = show, 0

    def __call__(self, compiled: int) -> None:
        self._count += compiled
        self._show(f"compiling what runs here for the first time ({self._count} functions done)", math.nan)


@contextmanager
def _shown() -> Iterator[Show]:
    if is_quiet():
        yield lambda *_: None
        return
    if not sys.stderr.isatty():
        yield Lines()
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def show(what: str, done: float) -> None:
            what = printable(what)
            if math.isnan(done):
                bar.tasks[0].total = None
                bar.update(task, description=what)
                return
            if what != bar.tasks[0].description or done < bar.tasks[0].completed:
                bar.tasks[0].total = 1.0
                bar.reset(task, description=what)  # a new phase has its own time left
            bar.update(task, completed=done)

        yield show


class Lines:
    """Prints one line for every completed tenth, at most one line in `_QUIET` s. now: a clock, s.

    If the fraction is unknown, the first line is printed at once.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._what, self._tenths, self._first = "", 0, 0.0
        self._began = self._said = now()
        self._unknown, self._waited = "", -math.inf

    def __call__(self, what: str, done: float) -> None:
        """Print the progress of the phase `what`, if it is time for a line. done: completed fraction, NaN if
        unknown.
        """
        now = self._now()
        if math.isnan(done):
            name = what.partition(" (")[0]
            if name != self._unknown or now - self._waited >= _QUIET:
                self._unknown, self._waited = name, now
                say(what)
            return
        tenths = int(10.0 * done)
        if what != self._what or tenths < self._tenths:
            self._what, self._tenths, self._first, self._began = what, tenths, done, now
        is_due = tenths != self._tenths or now - self._said >= _LONG
        if not is_due or now - self._said < _QUIET or done <= self._first:
            return
        self._tenths, self._said = tenths, now
        left = (now - self._began) * (1.0 - done) / (done - self._first)
        say(f"{what}: {done:.0%} done, about {left:.0f} s left")
