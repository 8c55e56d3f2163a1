"""Propose models for a recording: search the catalogue, fit the best candidates in the band, and search again.

Each round improves the catalogue: the fitted parameters become grid values, the fitted torque gives the columns of
delays and lags, and the residuals of the fit give the noise model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ga.arrays import Array, Mask
from ga.model.terms import SMALLEST, TERMS, is_addable
from hil.identification.candidates.band import Band
from hil.identification.candidates.band_fit import BandFit, BandFits
from hil.identification.candidates.catalogue import Catalogue, model_of
from hil.identification.candidates.search import Points, PointSearch, is_complete
from hil.signals import constants as c
from hil.signals.prepare import Signals

_SMALLEST = tuple(SMALLEST.split("+"))
_LATE = ("branch", "mass", "channel")


def proposed(
    signals: Signals, seen: Mask, terms: tuple[str, ...]
) -> tuple[list[BandFit], dict[str, Mapping[str, float]]]:
    """Return the models fitted to the samples in `seen` (n,), best first, and for each term of the candidates in
    Occam's window the nonlinear parameters, SI, by name, of the best candidate with that term.

    terms: those considered besides the smallest model's.
    """
    catalogue = Catalogue(Band.of(signals, seen), terms)
    search = PointSearch(catalogue)
    fits = _fits(search)
    search = _sharpened(search, _fitted(search, fits, search.first()))
    best: BandFit | None = None
    for _ in range(c.ROUNDS):
        fits, found = _fits(search), search.found()
        tried = [] if best is None else [fits.fit(best.terms, best.values)]
        tried += [_fitted(search, fits, one, best) for one in _different(search, [one for _, one in found])]
        for one in [fits.pruned(one) for one in tried]:
            if fits.may_win(one):
                _fit_exchanged(fits, one, terms)
        before, best = best, fits.best()[0]
        if not best.terms or (before is not None and set(before.terms) == set(best.terms)):
            break
        catalogue.add_values(best.terms, best.values)
        search = _learned(catalogue, best)
    values: dict[str, Mapping[str, float]] = {}
    for _, rival in reversed(found):
        values |= dict.fromkeys(search.terms(rival), search.values(rival))
    return fits.best(), values


def _sharpened(search: PointSearch, fit: BandFit) -> PointSearch:
    """Return the search with the noise model of a fit, and with the fitted values of each term that may help alone."""
    catalogue = search.catalogue
    search = _learned(catalogue, fit)
    alone, fits = search.helping_alone(), _fits(search)
    for candidate in alone:
        one = _fitted(search, fits, candidate)
        catalogue.add_values(one.terms, one.values)
    return _learned(catalogue, fit) if alone else search


def _learned(catalogue: Catalogue, fit: BandFit) -> PointSearch:
    """Return the search with the noise model of a fit, and with delays and lags of the torque of this fit.

    It changes the catalogue, to which terms of the torque's channel are added only here.
    """
    catalogue.band = catalogue.band.with_noise(fit.residuals)
    catalogue.read(_coupling_torque(catalogue, fit))
    search = PointSearch(catalogue)
    search.learn_spread()
    return search


def _fits(search: PointSearch) -> BandFits:
    return BandFits(search.catalogue.band, search.score, search.catalogue.size)


def _fitted(search: PointSearch, fits: BandFits, candidate: Points, near: BandFit | None = None) -> BandFit:
    values = search.values(candidate)
    return fits.fit(search.terms(candidate), values if near is None else {**near.values, **values})


def _fit_exchanged(fits: BandFits, fit: BandFit, terms: tuple[str, ...]) -> None:
    """Fit the models in which one term is replaced by another description of the same effect.

    Two laws of one effect exclude each other. A branch without a parallel damper has the same response as a lag, and an
    inertia looks like torque that is read early. If the model has one of these terms, the catalogue does not show how
    well each of the others would fit in its place.
    """
    for one in fit.terms:
        for other in (term for term in terms if term != one and _account_for_the_same(one, term)):
            larger = (*(term for term in fit.terms if term != one), other)
            if is_addable(other, (*_SMALLEST, *larger[:-1])) and is_complete(larger):
                exchanged = fits.fit(larger, fit.values)
                if fits.may_win(exchanged):
                    fits.pruned(exchanged)


def _account_for_the_same(one: str, other: str) -> bool:
    first, second = TERMS[one], TERMS[other]
    late = first.role in _LATE and second.role in _LATE
    return late or other in first.excludes or one in second.excludes


def _different(search: PointSearch, found: Sequence[Points]) -> list[Points]:
    """Return the first candidates of different terms, without those that only have other grid values."""
    first: dict[frozenset[str], Points] = {}
    for one in found:
        first.setdefault(frozenset(search.terms(one)), one)
    return list(first.values())[: c.FITTED]


def _coupling_torque(catalogue: Catalogue, fit: BandFit) -> Array:
    """Return the torque of a fit, N m, at all samples of the whole motion, before it passes the torque's channel."""
    motion = catalogue.band.motion
    model = model_of(motion, [term for term in fit.terms if TERMS[term].role != "channel"])
    genes = dict(zip((one.name for one in fit.model.linear), fit.genes.tolist(), strict=True))
    nonlinear = np.array([fit.values[one.name] for one in model.nonlinear])
    columns = model.raw_columns(motion.whole[0], nonlinear, fit.lag)
    return np.asarray(columns @ [genes[one.name] for one in model.linear])
