"""Compare a recorded rate with the deflection's derivative: the recorded rate may be delayed by a filter, or noisy.

Drives filter the velocity that they report. Beside an unfiltered deflection such a rate is late, and Kc changes by Bc
times the lag times the frequency squared. Lag and gain of the rate are those at which it best matches the derivative of
the deflection. Drives also report the rate in coarse steps or with noise, which lowers Bc; then the torque follows the
derivative better. A rate computed from differences of the deflection has all of the deflection's noise, and adds no
information.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnostics import Diagnostic
from hil.signals.constants import APART, ENOUGH, INDEPENDENT, LAGS, LONGEST_LAG, PREDICTED, RELEVANT, SAME_ERRORS, SURE

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OwnRate:
    """A recorded rate that differs from the deflection's derivative.

    lag: its delay, s. size: its gain relative to the derivative. noise: the fraction of the residuals' power that it
    adds in comparison with the derivative.
    """

    lag: float
    size: float
    noise: float = 0.0

    def diagnostic(self) -> Diagnostic:
        """Return the warning about this recorded rate."""
        if self.noise:
            text = (
                f"the recorded rate has noise or coarse steps: residuals have {100.0 * self.noise:.2g} % more power "
                "with it than with the derivative of the deflection. The derivative is used in its place, so Kc and Bc "
                "are not affected. Leave the column out"
            )
            return Diagnostic("unused-rate", text)
        late = "late" if self.lag >= 0.0 else "early"
        text = (
            f"the recorded rate is {1e3 * abs(self.lag):.3g} ms {late} and {self.size:.3g} times the derivative of the "
            "deflection: a filter acts on it. The derivative is used in its place, so Kc and Bc are not affected. "
            "Leave the column out"
        )
        return Diagnostic("unused-rate", text)


def refused_rate(
    time: Array, torque: Array, dtheta: Array, given: Array, derived: Array, *, highest: float
) -> OwnRate | None:
    """Return why a recorded rate is not used: it is filtered, or else noisy; None if it is used.

    given (n,): the recorded rate, rad/s. torque (n,) N m and dtheta (n,) rad: at time (n,) s. derived (n,): the
    deflection's derivative, rad/s. highest: the upper end of the excited band, Hz.
    """
    return own_rate(time, given, derived, highest) or _noisy(torque, dtheta, given, derived)


def is_difference(time: Array, dtheta: Array, given: Array, derived: Array) -> bool:
    """Return whether a recorded rate was computed from differences of the deflection.

    given (n,): the recorded rate, rad/s. dtheta (n,): the deflection, rad. The differences are those between both
    neighbours, or to the sample before or after; the rate then has the errors of the deflection. derived (n,): the
    deflection's derivative by local polynomials, rad/s.
    """
    good = np.flatnonzero(np.isfinite(derived))[:ENOUGH]
    quotients = np.diff(dtheta) / np.diff(time)
    before, after = np.append(quotients[0], quotients), np.append(quotients, quotients[-1])
    own = (given - derived)[good]
    return any(_are_alike(own, (rate - derived)[good]) for rate in (np.gradient(dtheta, time), before, after))


def _are_alike(errors: Array, others: Array) -> bool:
    power = float(np.sqrt((errors @ errors) * (others @ others)))
    return power > 0.0 and float(errors @ others) > SAME_ERRORS * power


def own_rate(time: Array, given: Array, derived: Array, highest: float) -> OwnRate | None:
    """Return how a recorded rate differs from the derivative of the deflection; None if it does not.

    time (n,): s. given (n,): the recorded rate, rad/s. derived (n,): the derivative, rad/s, NaN at samples without one.
    highest: the upper end of the excited band, Hz.
    """
    good = np.flatnonzero(np.isfinite(derived))[:ENOUGH]
    longest = LONGEST_LAG / highest
    known, inside = (time[good], derived[good]), _inside(time[good], longest)
    time, given, derived = time[good][inside], given[good][inside], derived[good][inside]
    power = float(derived @ derived)
    if power == 0.0:
        return None

    def left(lag: float) -> tuple[float, float]:
        shifted = np.interp(time - lag, *known)
        size = float(shifted @ given) / float(shifted @ shifted)
        return float(np.sum((given - size * shifted) ** 2)), size

    from scipy.optimize import minimize_scalar

    coarse = longest * np.arange(-LAGS, LAGS + 1) / LAGS
    nearest = float(coarse[np.argmin([left(lag)[0] for lag in coarse.tolist()])])
    width = longest / LAGS
    lag = float(minimize_scalar(lambda at: left(at)[0], bounds=(nearest - width, nearest + width), method="bounded").x)
    rest, size = left(lag)
    turning = np.gradient(known[1], known[0])[inside]
    independent = max(1.0, min(float(len(time)), INDEPENDENT * highest * float(time[-1] - time[0])))
    error = np.sqrt(rest / len(time) / independent)  # of a rate of 1 rad/s, coloured as the band is
    late = abs(lag) > max(RELEVANT[0] / (2.0 * np.pi * highest), SURE * error / float(np.sqrt(np.mean(turning**2))))
    other = abs(size - 1.0) > max(RELEVANT[0], SURE * error / float(np.sqrt(power / len(time))))
    return OwnRate(lag, size) if late or other else None


def _inside(time: Array, margin: float) -> NDArray[np.bool_]:
    """Return which samples at rising times (n,), s, are farther than `margin`, s, from every gap, so that a lag of that
    size does not reach into the gap.
    """
    gaps = np.flatnonzero(np.diff(time) > APART * np.median(np.diff(time)))
    edges = np.sort(np.concatenate([time[gaps], time[gaps + 1]]))
    before, after = np.searchsorted(edges, time - margin), np.searchsorted(edges, time + margin, side="right")
    return np.asarray(before == after)


def _noisy(torque: Array, dtheta: Array, given: Array, derived: Array) -> OwnRate | None:
    """Return by how much the recorded rate `given` is noisier than the derivative `derived`; None if it is not.

    The torque is fitted with a spring and a damper, once with each rate: the noisier rate leaves larger residuals.
    dtheta: deflection, rad.
    """
    good = np.flatnonzero(np.isfinite(derived))[:ENOUGH]
    target = torque[good]

    def left(rate: Array) -> float:
        columns = np.stack([np.ones(len(good)), dtheta[good], rate[good]], axis=1)
        return float(np.sum((target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]) ** 2))

    by_given, by_derived = left(given), left(derived)
    more = by_given / by_derived - 1.0 if by_derived > 0.0 else 0.0
    return OwnRate(0.0, 1.0, more) if more > PREDICTED else None
