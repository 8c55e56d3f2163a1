"""The motion that a model's torque is computed from, and the columns of its terms."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from ga.arrays import Array
from ga.model.cache import ROOM, SMALL
from ga.model.record import Regressors, Term
from ga.model.trajectory import Motion


@dataclass(frozen=True, eq=False)
class Seen:
    """The motion (n,) from which the torque is computed, and its regressors.

    motion: all samples if a torque cell filters the torque, else the samples that are requested. near: the regressors
    of the motion. whole: the regressors of all samples, if the torque of a term depends on other samples too; else
    equal to `near`.
    """

    motion: Motion
    near: Regressors
    whole: Regressors

    @property
    def is_whole(self) -> bool:
        """Return whether no term needs samples outside the motion."""
        return self.whole is self.near

    def passed(self, column: Array, *, bends: bool) -> Array:
        """Return a column (m,) of all samples at the samples of the motion (n,), filtered as the torque was.

        bends: whether the column is no linear filter of the motion; only such a column must be filtered.
        """
        whole, rows = self.motion.whole
        column = whole.filtered(column) if bends and self.motion.behind is not None else column
        return column if self.is_whole else column[rows]

    def changing(self, delay: float) -> tuple[Motion, Motion]:
        """Return the time derivatives, per second, of the motion and of the whole motion."""
        near = self.motion.changing(delay)
        return near, near if self.is_whole else self.motion.whole[0].changing(delay)

    def columns(
        self, present: Iterable[tuple[Term, bool, Array]], changing: tuple[Motion, Motion] | None = None
    ) -> list[Array]:
        """Return the columns (n,) of terms; with `changing`, their time derivatives.

        present: each term, whether its torque is no linear filter of the motion, and its parameters. Columns are kept
        with the motion, because most of them do not change in a search. The others are filtered together: that takes
        half as long.
        """
        asked = [self._asked(*one, changing) for one in present]
        bent = [column for one in asked if one.filtered for column in one.columns]
        passed = iter(self.motion.whole[0].filtered(np.stack(bent)) if bent else ())
        found: list[Array] = []
        for one in asked:
            columns = tuple(islice(passed, len(one.columns))) if one.filtered else one.columns
            if one.key is not None:
                one.motion.kept.keep("columns", one.key, columns, 1 + ROOM // (len(one.motion) + SMALL))
            found += [column[self.motion.whole[1]] for column in columns] if one.beyond else columns
        return found

    def _asked(self, term: Term, bends: bool, values: Array, changing: tuple[Motion, Motion] | None) -> _Asked:
        beyond = reaches(self.motion, term, bends=bends)
        own = self.whole if beyond else self.near
        own = replace(own, own=values) if len(values) else own  # thousands of times in a selection
        moved = own.key if term.uses_deflection else own.key[0]
        key = (term.name, term.columns, values.tobytes(), bends, moved) if changing is None else None
        known = None if key is None else own.motion.kept.recalled("columns", key)
        if known is not None:
            return _Asked(own.motion, None, known, beyond=beyond, filtered=False)
        columns = _computed(term, own, None if changing is None else changing[beyond])
        filtered = beyond and bends and self.motion.behind is not None
        return _Asked(own.motion, key, columns, beyond=beyond, filtered=filtered)


class _Asked(NamedTuple):
    """The columns (m,) of a term. beyond: whether the term depends on samples that are not requested; then the columns
    are of all samples. key: the key under which the motion must keep the columns; None if it keeps them already or must
    not. filtered: whether the columns must be filtered.
    """

    motion: Motion
    key: Hashable | None
    columns: tuple[Array, ...]
    beyond: bool
    filtered: bool


def _computed(term: Term, own: Regressors, changing: Motion | None) -> tuple[Array, ...]:
    found: tuple[Array, ...] = ()
    if term.columns is not None and changing is None:
        found = term.columns(own)
    elif term.rates is not None and changing is not None:
        found = term.rates(own, changing)
    elif term.columns is not None and changing is not None:
        moved = changing.dtheta * own.contact
        found = (term.pushed(own, np.ones(1), moved) if term.pushed else np.zeros_like(moved),)
    return tuple(own.loaded(term, *pair) for pair in zip(found, term.parameters, strict=False))


def reaches(motion: Motion, term: Term, *, bends: bool) -> bool:
    """Return whether a term's torque depends on other samples, through a state of the term or the torque's filter."""
    return term.forgets is not None or (bends and motion.behind is not None)
