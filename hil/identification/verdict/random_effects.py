"""Pool several measurements of one quantity: the variance within each, the variance between them, and the drift.

The model is value_i = x_i . beta + u_i + e_i. e_i has the known standard error of measurement i (within). u_i has one
unknown standard deviation for all and changes from one measurement to the next (between), as when the cable is laid
anew or the room's temperature changes. The between variance is that of Paule and Mandel (1982): with it the weighted
sum of squares equals its degrees of freedom. Intervals are those of Hartung and Knapp (2001) with Student's quantile,
because with a handful of recordings an interval with a normal quantile contains the true value far too seldom. They are
never narrower than the measurements' own errors allow, because two recordings may agree by luck. docs/data.md has the
outcome of the study that chose these methods.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ga.arrays import Array
from hil.signals.constants import BY_CHANCE, NEWTON_LIMIT, NORMAL, SINGULAR, UPPER


@dataclass(frozen=True, slots=True)
class Pooled:
    """The common value of m measurements, in their unit, with its standard error and 95 % interval.

    within: the root mean square of the measurements' standard errors. between: the standard deviation between the
    measurements. between_ci95: the 95 % interval of `between`, whose lower end is 0 if it is not significant. p_alike:
    the probability of values at least this far apart if the standard deviation between them were zero.
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
    """A slope over time, in the unit of the values per unit of the times, with its interval. p: the probability of such
    a slope by chance.
    """

    slope: float
    ci95: tuple[float, float]
    p: float


def between(values: Array, standard_errors: Array) -> Pooled:
    """Pool m measurements, at least 2, with their standard errors (m,).

    Raises ValueError for fewer than two, for unequal lengths, and for errors that are not finite and above zero.
    """
    from scipy.special import chdtrc

    ones = np.ones((len(values), 1))
    fit = _fit(ones, values, standard_errors)
    value, error = float(fit.beta[0]), float(max(fit.by_residuals[0], fit.by_errors[0]))
    half = float(fit.half_widths[0])
    alike = _weighted_squares(ones, values, standard_errors**2)[0]
    return Pooled(
        value=value,
        standard_error=error,
        ci95=(value - half, value + half),
        within=float(np.sqrt(np.mean(standard_errors**2))),
        between=float(np.sqrt(fit.variance)),
        between_ci95=_between_interval(ones, values, standard_errors, fit.freedom),
        p_alike=float(chdtrc(fit.freedom, alike)),
    )


def is_outside(value: float, values: Array, standard_error: float) -> bool:
    """Return whether a measurement is outside the 99 % prediction interval of m others, at least 2.

    value: the measurement. values (m,): the others. standard_error: the standard error of each measurement. If the
    others differ among themselves, a measurement that differs from them by as much is not outside. Raises ValueError as
    `between`.
    """
    from scipy.special import stdtrit

    pooled = between(values, np.full(len(values), standard_error))
    deviation = float(np.sqrt(pooled.standard_error**2 + pooled.between**2 + standard_error**2))
    return bool(abs(value - pooled.value) > -stdtrit(len(values) - 1, 0.5 * BY_CHANCE) * deviation)


def drift(times: Array, values: Array, standard_errors: Array) -> Drift:
    """Return the slope of measurements (m,) with their standard errors (m,) over times (m,), m at least 3.

    The variance between the measurements is that about the line. Raises ValueError as `between`, and if all times are
    equal.
    """
    if np.ptp(times) == 0.0:
        raise ValueError("all measurements have the same time: no drift can be estimated")
    from scipy.special import ndtr, stdtr

    scale = float(np.ptp(times))
    design = np.column_stack([np.ones(len(times)), (times - times.mean()) / scale])
    fit = _fit(design, values, standard_errors)
    slope, half = float(fit.beta[1]) / scale, float(fit.half_widths[1]) / scale
    steepness = abs(float(fit.beta[1]))
    by_residuals = float(stdtr(fit.freedom, -steepness / fit.by_residuals[1])) if fit.by_residuals[1] > 0.0 else 0.0
    by_errors = float(ndtr(-steepness / fit.by_errors[1]))
    return Drift(slope, (slope - half, slope + half), 2.0 * max(by_residuals, by_errors))


@dataclass(frozen=True, slots=True)
class _Fit:
    """The coefficients beta (p,), and the half width of their 95 % intervals (p,).

    by_residuals: standard errors (p,) from the residuals. by_errors: standard errors (p,) from the measurements' own
    errors alone. variance: the variance between the measurements. freedom: the degrees of freedom.
    """

    beta: Array
    by_residuals: Array
    by_errors: Array
    half_widths: Array
    variance: float
    freedom: int


def _fit(design: Array, values: Array, errors: Array) -> _Fit:
    from scipy.special import stdtrit  # scipy.stats would cost half a second of start-up

    count, width = design.shape
    if not values.shape == errors.shape == (count,):
        raise ValueError(f"{values.shape} values and {errors.shape} standard errors for {count} measurements")
    if count <= width:
        raise ValueError(f"{count} measurement(s) do not determine {width} parameter(s) and a variance: add more")
    if not (np.isfinite(values).all() and np.isfinite(errors).all() and (errors > 0.0).all()):
        raise ValueError("values must be finite, and standard errors finite and above zero")
    freedom = count - width
    variance = _variance_where(design, values, errors, float(freedom))
    weight = 1.0 / (errors**2 + variance)
    inverse = np.linalg.inv(design.T @ (weight[:, None] * design))
    beta = inverse @ (design.T @ (weight * values))
    # 1 where the between variance is above zero, by its definition; below 1 where the values agree by luck
    factor = float(np.sqrt(weight @ (values - design @ beta) ** 2 / freedom))
    by_residuals = np.sqrt(np.diag(inverse)) * factor
    by_errors = np.sqrt(np.diag(np.linalg.inv(design.T @ (design / errors[:, None] ** 2))))
    half = np.maximum(stdtrit(freedom, UPPER) * by_residuals, NORMAL * by_errors)
    return _Fit(beta, by_residuals, by_errors, half, variance, freedom)


def _weighted_squares(design: Array, values: Array, variances: Array) -> tuple[float, float]:
    """Return the sum of squares about the best fit, weighted by the inverse of the variances (m,), and its derivative.

    The derivative is that with respect to a common addition to all variances, with the sign reversed.
    """
    root = 1.0 / np.sqrt(variances)
    beta = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
    squares = (root * (values - design @ beta)) ** 2
    return float(squares.sum()), float((root**2) @ squares)


def _variance_where(design: Array, values: Array, errors: Array, squares: float) -> float:
    """Return the between variance at which the weighted sum of squares equals `squares`; 0 if no variance gives that
    sum.

    The sum falls with the variance and is convex, so Newton's method from 0 never overshoots.
    """
    variance = 0.0
    for _ in range(NEWTON_LIMIT):
        found, fall = _weighted_squares(design, values, errors**2 + variance)
        if found <= squares or found - squares <= SINGULAR * fall * variance:
            break
        variance += (found - squares) / fall
    return variance


def _between_interval(design: Array, values: Array, errors: Array, freedom: int) -> tuple[float, float]:
    """Return the Q-profile interval of the between variance by Viechtbauer (2007).

    It contains the variances whose weighted sum of squares lies between two chi-squared quantiles.
    """
    from scipy.special import chdtri

    low, high = (_variance_where(design, values, errors, float(chdtri(freedom, tail))) for tail in (1.0 - UPPER, UPPER))
    return float(np.sqrt(low)), float(np.sqrt(high))
