"""The columns of all terms that may explain a recording, computed once, at a grid of their nonlinear parameters.

Some terms, such as a gap, change the columns of other terms. Such a term has a column in the catalogue for the change
that it makes in the torque of the smallest model. Beside further terms this column is an approximation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from ga.arrays import Array
from ga.model.coupling import CouplingModel, lag_of
from ga.model.record import Parameter, Term
from ga.model.terms import SMALLEST, TERMS, canonical
from ga.model.trajectory import Motion
from hil.identification.candidates.band import Band
from hil.signals import constants as c

Cell = Callable[[Motion, Array, Array], Array]

_SMALLEST = tuple(SMALLEST.split("+"))


@dataclass(frozen=True, slots=True)
class Point:
    """Terms at one grid value, and their columns.

    terms: the term, last, after the needed term on which its columns depend, if any. values: their nonlinear
    parameters, SI, by name. at: the indices of their columns in the catalogue. positive: the indices of those whose
    factors cannot be negative. changed: the index of the column that is their change of the smallest model's torque; -1
    if they do not change it. place: the index of each value on the grid.
    """

    terms: tuple[str, ...]
    values: Mapping[str, float]
    at: tuple[int, ...]
    positive: tuple[int, ...] = ()
    changed: int = -1
    place: tuple[int, ...] = ()

    @property
    def parameters(self) -> int:
        """The number of parameters of its terms."""
        return sum(len(TERMS[term].parameters) for term in self.terms)


class Catalogue:
    """The points of all terms considered, and their columns in the band of a recording.

    points: all of them. columns (c, m): scaled to a mean square of 1; scale (c,): their r.m.s. before. base: indices of
    the columns of the smallest model, which every candidate has. lag: Bc/Kc of the smallest model, s. size: standard
    deviation of the torque, N m.
    """

    def __init__(self, band: Band, terms: Sequence[str]) -> None:
        self.band, self.terms, self.points = band, tuple(terms), list[Point]()
        self._columns, self._known = list[Array](), dict[int, int]()
        self._whole, self._places = band.motion.whole
        self._values = dict[str, list[float]]()  # fitted parameters of the torque's channel, besides those of the grid
        smallest = model_of(band.motion, ())
        self._smallest = smallest.raw_columns(self._whole, np.empty(0))
        self.base = self._added(list(self._smallest.T))
        (target,) = band.lowered(band.torque[None])
        self.size = float(np.std(target)) or 1.0
        self._genes = np.linalg.lstsq(np.array(self._columns).T, target, rcond=None)[0]
        self._genes[:2] = np.maximum(self._genes[:2], 0.0)
        self.lag = lag_of(*self._genes[:2].tolist())
        self._target = target / self.size
        for term in self.terms:
            if TERMS[term].role != "channel":
                self._add_grid(term)
        self._coupling = len(self._columns)
        self.read(self._smallest @ self._genes)

    def read(self, torque: Array) -> None:
        """Compute the columns of the terms that delay or filter the torque again, from the torque of a model.

        torque: N m, at all samples of the whole motion. The column of a delay is the slope of the torque; the measured
        torque has too much noise for a slope.
        """
        self._forget_channel()
        for name in self.terms:
            term = TERMS[name]
            if term.delays:
                at = self._added([-self._whole.slope(torque)])
                self.points.append(Point((name,), {}, at))
            elif term.cell is not None:
                self._add_cell(term, term.cell, torque)
        self.columns = np.array(self._columns)
        self.scale = np.sqrt((self.columns**2).mean(axis=1)) + np.finfo(float).tiny
        self.columns /= self.scale[:, None]

    def add_values(self, terms: Iterable[str], values: Mapping[str, float]) -> None:
        """Add points of these terms at fitted nonlinear parameters, SI, by name.

        Terms that delay or filter the torque get their points with the next `read`.
        """
        terms = set(terms)
        alike = {point.terms: point for point in self.points if point.values and set(point.terms) <= terms}
        self._forget_channel()
        for point in alike.values():
            own = {name: values[name] for name in point.values}
            if any(TERMS[term].role == "channel" for term in point.terms):
                for name, value in own.items():
                    self._values.setdefault(name, []).append(value)
            elif not any(_is_near(own, other.values) for other in self.points if other.terms == point.terms):
                self._add_point(point.terms, own, point.place)
        self._coupling = len(self._columns)

    def whitened(self) -> tuple[Array, Array]:
        """Return the columns (c, m) and the target (m,), both scaled, after the whitening filter."""
        return self.band.whitened(self.columns), self.band.whitened(self._target[None])[0]

    def _forget_channel(self) -> None:
        del self._columns[self._coupling :]
        self._known = {key: at for key, at in self._known.items() if at < self._coupling}
        self.points = [one for one in self.points if TERMS[one.terms[-1]].role != "channel"]

    def _add_cell(self, term: Term, cell: Cell, torque: Array) -> None:
        motion, (parameter,) = self.band.motion, term.parameters
        ((low, high),) = term.bounds(motion, self.band.highest) if term.bounds else ((0.0, 0.0),)
        grid = [low + part * (high - low) for part in parameter.starts] + self._values.get(parameter.name, [])
        for place, value in enumerate(grid):
            at = self._added([cell(motion, torque, np.array([value])) - torque[self._places]])
            self.points.append(Point((term.name,), {parameter.name: value}, at, at, place=(place,)))

    def _add_grid(self, name: str) -> None:
        for brought in _gridded_with(TERMS[name], self.terms):
            terms = (*brought, name)
            model = model_of(self.band.motion, terms)
            low, high = model.bounds(self.band.motion, self.band.highest)
            bounds = zip(model.nonlinear, low.tolist(), high.tolist(), strict=True)
            tried = [_grid(*one, few=bool(brought)) for one in bounds]
            for chosen in product(*tried):
                values = dict(zip((one.name for one in model.nonlinear), (value for _, value in chosen), strict=True))
                if _are_ordered(terms, values):
                    self._add_point(terms, values, tuple(place for place, _ in chosen))

    def _add_point(self, terms: tuple[str, ...], values: Mapping[str, float], place: tuple[int, ...]) -> None:
        model = model_of(self.band.motion, terms)
        nonlinear = np.array([values[one.name] for one in model.nonlinear])
        in_smallest = np.array([one in _OF_SMALLEST for one in model.linear])
        positive = [one.positive for one in model.linear if one not in _OF_SMALLEST]
        for lag in (self.lag, 0.0) if model.chooses_edge else (self.lag,):
            raw = model.raw_columns(self._whole, nonlinear, lag)
            changed = (raw[:, in_smallest] - self._smallest) @ self._genes[: len(self._smallest.T)]
            at = self._added(list(raw.T[~in_smallest]))
            held = tuple(one for one, is_positive in zip(at, positive, strict=True) if is_positive)
            of_change = self._added([changed]) if np.std(changed) > 1e-6 * self.size else ()
            columns = tuple(dict.fromkeys((*at, *of_change, *self._added(self._beginnings(terms, values)))))
            first = of_change[0] if of_change else -1
            self.points.append(Point(terms, dict(values), columns, held + of_change, first, place))

    def _beginnings(self, terms: Sequence[str], values: Mapping[str, float]) -> list[Array]:
        """Return the columns of the torque that unknown states at the beginning of pieces may cause."""
        found = []
        for term in (TERMS[name] for name in terms):
            if term.forgets is not None:
                own = np.array([values[one.name] for one in term.parameters if one.nonlinear])
                left = term.forgets(self._whole, own)
                found += [left] if left[self._places][self.band.rows].max(initial=0.0) > c.NEGLIGIBLE else []
        return found

    def _added(self, columns: Sequence[Array]) -> tuple[int, ...]:
        """Add columns (n,) to the catalogue and return their indices; equal columns are stored once."""
        found = []
        for column in columns:
            at = column[self._places] if len(column) == len(self._whole) else column
            key = hash(at.tobytes())
            if key not in self._known:
                self._columns.append(self.band.lowered(at[None])[0])
                self._known[key] = len(self._columns) - 1
            found.append(self._known[key])
        return tuple(found)


_OF_SMALLEST = frozenset(one for name in _SMALLEST for one in TERMS[name].parameters)


def model_of(motion: Motion, terms: Iterable[str]) -> CouplingModel:
    """Return the smallest model with these terms, anchored to the motion."""
    return CouplingModel(canonical("+".join(dict.fromkeys((*_SMALLEST, *terms))))).anchored(motion)


def _gridded_with(term: Term, considered: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the needed terms whose parameters are tried together with the term's, one tuple for each possibility: [()]
    if the term is tried alone, [] if it needs one that is not considered.

    They are if the columns of one term depend on the other's parameters. Any other needed term, such as an offset, must
    be in the candidate already.
    """
    needs = [need for need in (term.needs, *term.or_needs) if need]
    brings = [need for need in needs if TERMS[need].bounds is not None or term.smooths]
    return [(need,) for need in brings if need in considered] if brings else [()]


def _grid(parameter: Parameter, low: float, high: float, *, few: bool) -> list[tuple[int, float]]:
    """Return the grid of a parameter: indices and values. few: whether an unloaded deflection gets only one value."""
    if parameter.kind == "load share":
        return [(0, min(c.LITTLE_FRICTION, high))]
    starts = [0.5] if few and parameter.kind == "unloaded place" else list(parameter.starts)
    values = [(place, low + part * (high - low)) for place, part in enumerate(starts)]
    return [one for one in values if one[1] != parameter.absent] or values


def _are_ordered(terms: Iterable[str], values: Mapping[str, float]) -> bool:
    """Return whether each branch relaxes faster than the one before: in another order the model is the same."""
    own = [one.name for term in terms for one in TERMS[term].parameters if one.kind == "relaxation time"]
    return all(values[one] > values[other] for one, other in pairwise(own))


def _is_near(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    return all(abs(one[name] - other[name]) <= c.SAME * abs(other[name]) for name in one)
