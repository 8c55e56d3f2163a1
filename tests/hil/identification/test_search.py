"""The search scores as a least-squares fit would, its columns are the models' own, and exact fits prune what it found.

Each term of the table that model selection considers has its place in it.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from ga.model.terms import TERMS
from hil.identification.candidates.band import Band
from hil.identification.candidates.band_fit import BandFits
from hil.identification.candidates.catalogue import Catalogue, model_of
from hil.identification.candidates.search import PointSearch, Score, odds
from hil.signals.prepare import Signals

from .chirps import BC, KC, SELECTED, chirp, linear, noise, signals

Array = NDArray[np.float64]

MOVED = chirp()


def with_gap(gap: float) -> Array:
    return KC * np.sign(MOVED.dtheta) * np.maximum(np.abs(MOVED.dtheta) - gap, 0.0) + BC * MOVED.rate


def band_of(given: Signals) -> Band:
    return Band.of(given, np.ones(len(given), dtype=bool))


@cache
def catalogue() -> Catalogue:
    return Catalogue(band_of(signals(MOVED.motion, linear(MOVED) + noise(2e-4))), SELECTED)


def test_the_catalogue_has_a_point_of_each_term_that_is_considered() -> None:
    assert {point.terms[-1] for point in catalogue().points} == set(SELECTED)
    assert np.isfinite(catalogue().columns).all()


def test_the_column_of_what_a_term_changes_is_the_difference_that_it_makes_to_the_models_torque() -> None:
    """At the parameters of the smallest model, for flanks that push only and for flanks that part at the edge."""
    found, (whole, _) = catalogue(), MOVED.motion.whole
    smallest = model_of(MOVED.motion, ())
    genes = np.linalg.lstsq(found.columns[list(found.base)].T, found.band.lowered(found.band.torque[None])[0])[0]
    genes /= found.scale[list(found.base)]
    changing = [point for point in found.points if point.changed >= 0 and TERMS[point.terms[-1]].role == "play"]
    assert changing
    parted = list[bool]()
    for point in changing:
        model = model_of(MOVED.motion, point.terms)
        nonlinear = np.array([point.values[one.name] for one in model.nonlinear])
        kept = [at for at, one in enumerate(model.linear) if one in smallest.linear]
        torques = [model.raw_columns(whole, nonlinear, lag)[:, kept] @ genes for lag in (found.lag, 0.0)]
        expected = found.band.lowered(np.array(torques) - smallest.raw_columns(whole, np.empty(0)) @ genes)
        column = found.columns[point.changed] * found.scale[point.changed]
        alike = [np.allclose(column, one, atol=1e-6 * np.abs(one).max()) for one in expected]
        assert any(alike)
        parted += alike if model.chooses_edge else []
    assert parted.count(True) == parted.count(False)


def test_all_scores_from_the_gram_matrix_are_those_of_least_squares_fits() -> None:
    """But that a candidate with a factor that cannot be negative, and is, is rated lower."""
    search, found = PointSearch(catalogue()), catalogue()
    (columns, target), beside = found.whitened(), search.beside(())
    possible = np.flatnonzero(beside > -np.inf).tolist()
    assert len(possible) > 100
    for number in possible[::7]:
        point = found.points[number]
        at = list(dict.fromkeys((*found.base, *point.at)))
        factors, *_ = np.linalg.lstsq(columns[at].T, target, rcond=1e-6)
        left = target - factors @ columns[at]
        alike = sum(one.terms == point.terms for one in found.points)
        score = Score(len(target)).of(float(left @ left), point.parameters) + odds(point.terms) - 2.0 * np.log(alike)
        assert beside[number] == pytest.approx(score, abs=0.02)
        held = {*found.base[:2], *point.positive}
        if any(one in held and factor < 0.0 for one, factor in zip(at, factors, strict=True)):
            assert search.rated((number,)) < score
        else:
            assert search.rated((number,)) == pytest.approx(score, abs=0.02)


def test_fitted_values_stand_on_the_grid_once_for_each_kind_of_flank() -> None:
    found = Catalogue(catalogue().band, ("offset", "backlash", "lag"))
    before, fitted = len(found.points), {"gap": 0.0123, "centre": 0.0045, "lag": 0.0067}
    for _ in range(2):
        found.add_values(("backlash", "lag"), fitted)
        found.read(linear(MOVED))
    values = [point.values for point in found.points]
    same = [one for one in values if one.get("gap") == fitted["gap"] and one.get("centre") == fitted["centre"]]
    assert len(same) == 2  # of flanks that push only, and of flanks that part at the edge
    assert any(one.get("lag") == fitted["lag"] for one in values)
    assert len(found.points) > before


def test_whitening_makes_white_what_follows_a_known_autoregression() -> None:
    band = band_of(signals(MOVED.motion, linear(MOVED)))
    given = noise(1.0, samples=len(band.rows))
    coloured = lfilter([1.0], [1.0, -0.9, 0.5], given)
    (white,) = band.with_noise(coloured).whitened(coloured[None])
    assert np.std(white - given[-len(white) :]) < 0.2
    assert np.std(coloured - given) > 0.5


def test_a_term_that_only_made_up_for_the_grid_is_pruned() -> None:
    band = band_of(signals(MOVED.motion, with_gap(0.0437) + noise(2e-4)))
    fits = BandFits(band, Score(len(band.rows)), float(np.std(band.torque)))
    found = fits.pruned(fits.fit(("offset", "deadband", "cubic"), {"gap": 0.06, "centre": 0.0}))
    assert found.terms == ("deadband",)
    assert found.values["gap"] == pytest.approx(0.0874, rel=0.02)
