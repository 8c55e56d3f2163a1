"""Search the excitation with the smallest errors of Kc and Bc within a stand's limits.

The deflection is proportional to the amplitude. So every excitation is assessed at the largest amplitude that keeps the
limits for every Kc and Bc within `ROUGH_RANGE`, and only kind and band are searched.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

from hil.acquisition import excitation
from hil.acquisition.excitation import EXCITATIONS, Profile
from hil.errors import WrongUse
from hil.experiment_design.assessment import Assessment, Task, assess, rounded, worst_shares
from hil.experiment_design.fisher import predict
from hil.experiment_design.response import respond
from hil.printable import quoted
from hil.recording.ahead import Progress

T = TypeVar("T")

_SEED = 0  # of a PRBS, the default of `hil record`

_KINDS = tuple(name for name, excitation in EXCITATIONS.items() if excitation.searched)
_OCTAVES = 2.0  # the narrowest band searched: friction and damping look alike at one speed
_PERIODS = 2.0  # of the lowest frequency in the run, at least
_TICKS = 10.0  # in a period of the highest frequency, for which the narrowest window's rate is within 0.5 %
_FADE, _SHORTEST_FADE = 1.0, 0.1  # s, the default of `hil record` and its minimum
_LONGEST = 5.0  # s of the runs in the search; standard errors fall with the root of the duration, a bias does not


def best(task: Task, duration: float, progress: Progress | None = None) -> Assessment:
    """Return the assessment of the excitation of `duration` s that has the smallest relative error of Kc and Bc within
    the limits.

    First, a grid over kind and band in steps of an octave. Then, for each kind, smaller and smaller steps of both ends
    of the best band. Finally, the best excitation of each kind over the whole duration. progress: called after each
    step. Raises WrongUse if no band fits the rate and the duration, or if no motion can distinguish the terms.
    """
    span = min(duration, _LONGEST)
    lowest, highest = rounded(_PERIODS / span), rounded(task.rate / _TICKS, down=True)
    if not highest >= lowest * 2.0**_OCTAVES:
        raise WrongUse(
            f"{duration:g} s at {task.rate:g} Hz leave no band of {_OCTAVES:g} octaves to choose from: "
            "give a longer --duration or a higher --rate"
        )
    search = _Search(task, duration, (lowest, highest))
    ends = _octaves(lowest, highest)
    for kind, low, high in _followed(itertools.product(_KINDS, ends, ends), "trying bands", progress):
        search.judge(kind, low, high)
    if math.isinf(min(search.errors.values())):
        raise WrongUse(
            f"no excitation identifies Kc and Bc with --model {quoted(task.model)}: some of its terms look the same "
            "in every motion (skew looks like a damping and an inertia together); leave one out"
        )
    for kind in _followed(_KINDS, "refining the best", progress):
        search.refine(kind)
    chosen = [min((key for key in search.errors if key[0] == kind), key=search.errors.__getitem__) for kind in _KINDS]
    whole = [assess(task, _largest(task, _made(task, kind, band, duration, _FADE))) for kind, band in chosen]
    return min(whole, key=lambda one: one.relative)


def _followed(items: Iterable[T], what: str, progress: Progress | None) -> Iterator[T]:
    """Yield the items, and call `progress` with the text `what` and the completed fraction after each."""
    every = list(items)
    for number, item in enumerate(every, 1):
        yield item
        if progress is not None:
            progress(what, number / len(every))


class _Search:
    """The state of the search: the relative errors of every kind and band assessed so far.

    duration: of the whole run, s. A run in the search is at most `_LONGEST` s long, and its fade is shortened in
    proportion.
    """

    def __init__(self, task: Task, duration: float, reach: tuple[float, float]) -> None:
        self.errors: dict[tuple[str, tuple[float, float]], float] = {}
        self._task = task
        self._span = min(duration, _LONGEST)
        self._fade = max(_FADE * self._span / duration, _SHORTEST_FADE)
        self._scatter = math.sqrt(self._span / duration)  # of the whole run over that of a run in the search
        self._reach = reach

    def judge(self, kind: str, low: float, high: float) -> None:
        """Assess the possible band that is nearest to `low` to `high`, Hz, unless it is too narrow or was assessed
        before.
        """
        low, high = rounded(max(low, self._reach[0])), rounded(min(high, self._reach[1]))
        if EXCITATIONS[kind].from_zero:
            low = self._reach[0]
        if high >= low * 2.0**_OCTAVES and (kind, (low, high)) not in self.errors:
            self.errors[kind, (low, high)] = self._error(kind, (low, high))

    def refine(self, kind: str) -> None:
        """Change the best band of a kind in steps, down to steps of 5 %, until no step improves the error."""
        step = math.sqrt(2.0)
        while step > 1.05:
            low, high = min((key for key in self.errors if key[0] == kind), key=self.errors.__getitem__)[1]
            before = self.errors[kind, (low, high)]
            for lower, upper in ((low / step, high), (low * step, high), (low, high / step), (low, high * step)):
                self.judge(kind, lower, upper)
            if not min(error for key, error in self.errors.items() if key[0] == kind) < 0.999 * before:
                step = math.sqrt(step)

    def _error(self, kind: str, band: tuple[float, float]) -> float:
        """Return the relative error of Kc or Bc, whichever is larger, for an excitation over the whole run at the
        largest allowed amplitude.
        """
        profile = _largest(self._task, _made(self._task, kind, band, self._span, self._fade))
        motion, _ = respond(self._task.joint, profile, self._task.rate)
        kc, bc = predict(self._task.terms, self._task.joint, motion, self._task.readings)[:2]
        return max(kc.relative(self._scatter), bc.relative(self._scatter))


def _octaves(lowest: float, highest: float) -> list[float]:
    """Return frequencies from the lowest to the highest, at most an octave apart."""
    count = math.ceil(math.log2(highest / lowest))
    return [lowest * (highest / lowest) ** (index / count) for index in range(count + 1)]


def _largest(task: Task, profile: Profile) -> Profile:
    """Return the profile, which has amplitude one, scaled to the largest amplitude within all limits."""
    amplitude = min(task.own_limit, 1.0 / max(worst_shares(task, profile)))
    return replace(profile, amplitude=rounded(amplitude, down=True))


def _made(task: Task, kind: str, band: tuple[float, float], duration: float, fade: float) -> Profile:
    return excitation.make(
        kind,
        task.mode,
        amplitude=1.0,
        default_amplitude=1.0,
        duration=duration,
        band=band,
        rate=task.rate,
        fade=fade,
        seed=_SEED,
    )
