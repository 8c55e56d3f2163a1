"""Several measurements of one quantity: what belongs to each of them, what lies between them, and what drifts.

The model is value_i = x_i . beta + u_i + e_i, where e_i has the known standard error of measurement i (within) and u_i,
the same unknown standard deviation for all, is what changes from one measurement to the next (between): the cable laid
anew, the room's temperature. The between variance is Paule and Mandel's (1982): the one that makes the weighted sum of
squares equal to its degrees of freedom. Intervals are Hartung and Knapp's (2001) with Student's quantile, because a
normal quantile covers far too little with the handful of recordings a stand yields; they are never narrower than what
the measurements' own errors leave of a common value, for two recordings may agree by luck. docs/data.md holds the study
that chose them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NORMAL = 1.959964  # half a 95 % interval in standard deviations
_STEPS = 200  # a step at least doubles a variance that is far too small: enough for 60 decades
_ROUNDING = 1e-14


@dataclass(frozen=True, slots=True)
class Pooled:
    """The common value of m measurements, in their unit, with its standard error and 95 % interval.

    within: the measurements' typical own standard error (root mean square). between: the standard deviation of what
    changes from one to the next; between_ci95: its 95 % interval, whose lower end is 0 where it cannot be told from
    none. p_alike: the probability of values at least this far apart if nothing lay between them.
    """

    value: float
    standard_error: float
    ci95: tuple[float, float]
    within: float
    between: float
    between_ci95: tuple[float, float]
    p_alike: float


@dataclass(frozen=True, slots=True)
class Drift:
    """A slope in time: unit of the values per unit of the times; p: the probability of one as steep by chance."""

    slope: float
    ci95: tuple[float, float]
    p: float


def between(values: Array, standard_errors: Array) -> Pooled:
    """Pool measurements (m,) with their own standard errors (m,), m at least 2.

    Raises ValueError for fewer than two, for unequal lengths, and for errors that are not finite and above zero.
    """
    ones = np.ones((len(values), 1))
    fit = _fit(ones, values, standard_errors)
    value, error = float(fit.beta[0]), float(max(fit.scatter[0], fit.least[0]))
    half = float(fit.half_widths[0])
    alike = _weighted_squares(ones, values, standard_errors**2)[0]
    return Pooled(
        value=value,
        standard_error=error,
        ci95=(value - half, value + half),
        within=float(np.sqrt(np.mean(standard_errors**2))),
        between=float(np.sqrt(fit.variance)),
        between_ci95=_between_interval(ones, values, standard_errors, fit.freedom),
        p_alike=_chance(fit.freedom, alike),
    )


def drift(times: Array, values: Array, standard_errors: Array) -> Drift:
    """The slope of measurements (m,) with their standard errors (m,) over times (m,), m at least 3.

    What lies between the measurements counts as scatter about the line. Raises ValueError as `between` does, and where
    all times are the same.
    """
    if np.ptp(times) == 0.0:
        raise ValueError("all measurements have the same time: no drift can be told")
    from scipy.special import ndtr, stdtr

    scale = float(np.ptp(times))
    design = np.column_stack([np.ones(len(times)), (times - times.mean()) / scale])
    fit = _fit(design, values, standard_errors)
    slope, half = float(fit.beta[1]) / scale, float(fit.half_widths[1]) / scale
    steepness = abs(float(fit.beta[1]))
    by_scatter = float(stdtr(fit.freedom, -steepness / fit.scatter[1])) if fit.scatter[1] > 0.0 else 0.0
    by_errors = float(ndtr(-steepness / fit.least[1]))
    return Drift(slope, (slope - half, slope + half), 2.0 * max(by_scatter, by_errors))


@dataclass(frozen=True, slots=True)
class _Fit:
    """beta (p,), their standard errors from the scatter and from the measurements' own errors alone (p,).

    half_widths: of their 95 % intervals (p,). variance: between. freedom: degrees of freedom left.
    """

    beta: Array
    scatter: Array
    least: Array
    half_widths: Array
    variance: float
    freedom: int


def _fit(design: Array, values: Array, errors: Array) -> _Fit:
    count, width = design.shape
    if not values.shape == errors.shape == (count,):
        raise ValueError(f"{values.shape} values and {errors.shape} standard errors for {count} measurements")
    if count <= width:
        raise ValueError(f"{count} measurement(s) cannot tell {width} parameter(s) and their scatter: add more")
    if not (np.isfinite(values).all() and np.isfinite(errors).all() and (errors > 0.0).all()):
        raise ValueError("values must be finite, and standard errors finite and above zero")
    freedom = count - width
    variance = _variance_where(design, values, errors, float(freedom))
    weight = 1.0 / (errors**2 + variance)
    inverse = np.linalg.inv(design.T @ (weight[:, None] * design))
    beta = inverse @ (design.T @ (weight * values))
    # one where there is a between variance, by its definition; below where the values lie closer than their errors
    factor = float(np.sqrt(weight @ (values - design @ beta) ** 2 / freedom))
    scatter = np.sqrt(np.diag(inverse)) * factor
    least = np.sqrt(np.diag(np.linalg.inv(design.T @ (design / errors[:, None] ** 2))))
    half = np.maximum(_student(freedom, 0.975) * scatter, _NORMAL * least)
    return _Fit(beta, scatter, least, half, variance, freedom)


def _weighted_squares(design: Array, values: Array, variances: Array) -> tuple[float, float]:
    """The sum of squares about the best fit, each measurement weighted with its variance (m,), and how fast it falls.

    The latter is per unit by which all variances grow; the fit being the best, its own change counts for nothing.
    """
    root = 1.0 / np.sqrt(variances)
    beta = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
    squares = (root * (values - design @ beta)) ** 2
    return float(squares.sum()), float((root**2) @ squares)


def _variance_where(design: Array, values: Array, errors: Array, squares: float) -> float:
    """The between variance at which the weighted sum of squares is `squares`; 0 if none is.

    The sum falls with the variance, ever more slowly, so that Newton's steps from 0 never go too far.
    """
    variance = 0.0
    for _ in range(_STEPS):
        found, fall = _weighted_squares(design, values, errors**2 + variance)
        if found <= squares or found - squares <= _ROUNDING * fall * variance:
            break
        variance += (found - squares) / fall
    return variance


def _between_interval(design: Array, values: Array, errors: Array, freedom: int) -> tuple[float, float]:
    """Viechtbauer's Q-profile (2007): the variances that the sum of squares, chi squared, does not contradict."""
    from scipy.special import chdtri

    low, high = (_variance_where(design, values, errors, float(chdtri(freedom, tail))) for tail in (0.025, 0.975))
    return float(np.sqrt(low)), float(np.sqrt(high))


def _chance(freedom: int, squares: float) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(freedom, squares))


def _student(freedom: int, quantile: float) -> float:
    from scipy.special import stdtrit  # scipy.stats would cost half a second of start-up

    return float(stdtrit(freedom, quantile))
