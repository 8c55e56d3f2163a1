"""The motion that a model's torque is computed from, and the columns of its terms."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from ga.arrays import Array
from ga.model.record import Regressors, Term
from ga.model.trajectory import Motion


@dataclass(frozen=True, eq=False)
class ColumnSource:
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
        self, present: Iterable[tuple[Term, bool, Array]], motion_rates: tuple[Motion, Motion] | None = None
    ) -> list[Array]:
        """Return the columns (n,) of terms; with `motion_rates`, their time derivatives.

        present: each term, whether its torque is no linear filter of the motion, and its parameters. Columns that must
        be filtered are filtered together: that takes half as long.
        """
        computed = [self._computed(term, bends, values, motion_rates) for term, bends, values in present]
        bent = [column for columns, _, filtered in computed if filtered for column in columns]
        whole, rows = self.motion.whole
        passed = iter(whole.filtered(np.stack(bent)) if bent else ())
        requested: list[Array] = []
        for columns, beyond, filtered in computed:
            every = islice(passed, len(columns)) if filtered else columns
            requested += [column[rows] for column in every] if beyond else every
        return requested

    def _computed(
        self, term: Term, bends: bool, values: Array, motion_rates: tuple[Motion, Motion] | None
    ) -> tuple[tuple[Array, ...], bool, bool]:
        """Return the columns (m,) of a term, whether they are of all samples because the term depends on samples that
        are not requested, and whether they must be filtered.
        """
        beyond = reaches(self.motion, term, bends=bends)
        regressors = self.whole if beyond else self.near
        regressors = replace(regressors, own=values) if len(values) else regressors  # thousands of times in a selection
        columns = _columns_of(term, regressors, None if motion_rates is None else motion_rates[beyond])
        return columns, beyond, beyond and bends and self.motion.behind is not None


def _columns_of(term: Term, regressors: Regressors, motion_rate: Motion | None) -> tuple[Array, ...]:
    """Return the columns (n,) of one term, N m per unit of its parameters; with `motion_rate`, the time derivatives of
    the columns.
    """
    columns: tuple[Array, ...] = ()
    if motion_rate is None:
        columns = term.columns(regressors) if term.columns is not None else ()
    elif term.rates is not None:
        columns = term.rates(regressors, motion_rate)
    elif term.columns is not None:
        moved = motion_rate.dtheta * regressors.contact
        columns = (term.pushed(regressors, np.ones(1), moved) if term.pushed else np.zeros_like(moved),)
    return tuple(regressors.loaded(term, *pair) for pair in zip(columns, term.parameters, strict=False))


def reaches(motion: Motion, term: Term, *, bends: bool) -> bool:
    """Return whether a term's torque depends on other samples, through a state of the term or the torque's filter."""
    return term.forgets is not None or (bends and motion.behind is not None)
