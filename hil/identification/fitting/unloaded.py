"""Find the deflection at which the joint is unloaded: there the Kc of a spring that curves is defined.

Three indicators of the unloaded deflection exist, and each can be wrong: the encoder's zero, if it was set there; the
zero of the torque, if its reading has no offset; and the symmetry of the spring, if it is equal in both directions. Two
indicators that agree are believed, because no common cause gives them the same error. A single indicator is believed if
it lies closer to the encoder's zero (or, if that is far away, to the torque's zero) than chance explains; Kc is then
the stiffness anywhere between the two. Otherwise Kc may be the stiffness at any deflection of the motion. Deflections
count from the unloaded deflection, so that Kc does not depend on an angle added to all readings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.polynomial import Legendre

from ga.arrays import Array
from ga.lad.exact import least_absolute_deviations
from ga.model.record import Regressors, Term
from ga.model.separable import SeparableModel
from ga.model.terms import of_kind, size_of
from ga.model.trajectory import Motion
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import covariance
from hil.signals import constants as c
from hil.signals.angle import far_zero
from hil.signals.prepare import Signals

UNLOADED_PLACE = "unloaded place"
DEFLECTION = "deflection"
"""The quantity on which the Kc of a spring that curves depends, if the unloaded deflection is not known."""

Span = tuple[float, float, str]
"""The smallest and the largest Kc, N m/rad, of a model without a single Kc, and the quantity on which Kc depends ("":
Kc varies only by errors).
"""


@dataclass(frozen=True, slots=True)
class Unloaded:
    """The deflection at which the joint is unloaded.

    reference: the encoder reading, rad, that deflections count from; 0 for the encoder's own zero. low, high: the range
    of deflections, rad from `reference`, in which the joint is unloaded. agreed: whether two indicators nearly agree.
    """

    reference: float = 0.0
    low: float = 0.0
    high: float = 0.0
    agreed: bool = True

    def span(self, values: Mapping[str, float], terms: Iterable[Term]) -> Span | None:
        """Return the smallest and the largest Kc, N m/rad, of a model of these terms with these values, SI, by name.

        None for a spring that does not curve, for a model with an unloaded deflection of its own, and if that
        deflection is known.
        """
        if self.low == self.high == 0.0 or of_kind(values, "gap width", "slack end", "unloaded place"):
            return None
        place = np.append(np.linspace(self.low, self.high, c.CURVE_POINTS), min(max(self.low, 0.0), self.high))
        rise = sum((_stiffening(term, values, place) for term in terms if term.role == "curve"), np.zeros(len(place)))
        if not rise.any():
            return None
        found = values["Kc"] + rise
        return float(found.min()), float(found.max()), "" if self.agreed else UNLOADED_PLACE

    def beside_turn(self, values: Mapping[str, float], motion: float) -> Span | None:
        """Return the two stiffnesses, N m/rad, of a spring whose stiffness changes at a deflection that is not the
        unloaded one.

        The two are then not the stiffnesses in the two directions from rest, and their mean describes nothing. None for
        other springs, and if the unloaded deflection is unknown. values: the model's parameters, SI, by name. motion:
        the range of the deflection, rad.
        """
        turns = of_kind(values, "side place")
        if not turns or not self.agreed:
            return None
        turn, half = values[turns[0]], abs(size_of(values, "side stiffness"))
        if abs(turn - min(max(turn, self.low), self.high)) <= c.SAME_PLACE * motion:
            return None
        return values["Kc"] - half, values["Kc"] + half, DEFLECTION


def _stiffening(term: Term, values: Mapping[str, float], place: Array) -> Array:
    """Return the stiffness (k,), N m/rad, that a curve adds to Kc at deflections (k,), rad."""
    if term.pushed is None:
        return np.zeros(len(place))
    own = [np.array([values[one.name] for one in term.parameters if one.nonlinear is kind]) for kind in (False, True)]
    ones, still = np.ones(len(place)), np.zeros(len(place))
    motion = Motion(np.arange(len(place), dtype=np.float64), place, still, still, still)
    seen = Regressors(motion.time, motion, place, ones, None, damped=True, smoothing=0.0, middle=0.0, own=own[1])
    return term.pushed(seen, own[0], ones)


Rest = Callable[[Signals], Unloaded]
"""A function that returns where the joint of the signals is unloaded."""


def rest_for(model: SeparableModel | None) -> Rest:
    """Return the function that finds the unloaded deflection for a model. model: None if the model is to be selected.

    The function returns the encoder's zero if a parameter of the model counts from it: gap and slack do, and parameters
    of a user's model may. A model named without an offset states that the torque reading has none.
    """
    if model is None:
        return unloaded
    if not model.linear or of_kind((parameter.name for parameter in model.nonlinear), "gap middle", "slack end"):
        return lambda _signals: Unloaded()
    return partial(unloaded, balanced=not of_kind((parameter.name for parameter in model.linear), "torque at rest"))


def unloaded(signals: Signals, *, balanced: bool = False) -> Unloaded:
    """Return where the joint is unloaded: at the encoder's zero, unless that is far away or the other indicators
    contradict it.

    balanced: whether the torque is known to have no offset; then the zero of the torque needs no second indicator.
    """
    angle = signals.motion.dtheta
    middle = far_zero(angle)
    try:
        curve = _curve(signals)
    except RuntimeError:
        return Unloaded(middle)
    balance, symmetric = curve.crossing(0), curve.crossing(2)
    encoder = 0.0 if middle == 0.0 else None
    if len(curve.coefficients) == 2:  # the stiffness is the same everywhere
        return Unloaded(middle if encoder == 0.0 or balance is None else balance)
    agreeing = _agreeing(curve, encoder, balance)
    if not agreeing and balanced and balance is not None:
        agreeing = [balance]
    if agreeing:
        return _between(agreeing, agreeing[0], agreed=True)
    known = [place for place in (encoder, balance, symmetric) if place is not None]
    near = [place for place in known if abs(place - known[0]) <= c.SAME_PLACE * float(np.ptp(angle))]
    if len(near) > 1:
        return _between(near, near[-1], agreed=True)
    return _between([*known, float(angle.min()), float(angle.max())], [middle, *known][-1], agreed=False)


def _agreeing(curve: _Curve, encoder: float | None, balance: float | None) -> list[float]:
    """Return the deflections, rad, of the encoder's zero and of the torque's zero, in this order, that another
    indicator confirms.
    """
    places = [place for place in (encoder, balance) if place is not None]
    if encoder is not None and curve.imbalance(encoder) <= curve.limit:
        return places
    against = [curve.asymmetry(place) for place in places]
    most = min(curve.limit, min(against, default=0.0) + c.STRONG)
    return [place for place, gain in zip(places, against, strict=True) if gain <= most]


def _between(places: list[float], reference: float, *, agreed: bool) -> Unloaded:
    return Unloaded(reference, min(places) - reference, max(places) - reference, agreed)


@dataclass(frozen=True, eq=False)
class _Curve:
    """The static torque, N m, over the deflection, rad: a series with coefficients (p,) and their covariance (p, p).

    scale: the range of the torque, N m. limit: the ratio of squared deviation to variance above which evidence is
    strong.
    """

    coefficients: Array
    covariance: Array
    domain: tuple[float, float]
    scale: float
    limit: float

    def imbalance(self, place: float) -> float:
        """Return the evidence that the torque is not zero at a deflection, rad: its square over its variance."""
        return self._evidence(self._series(place))

    def asymmetry(self, place: float) -> float:
        """Return the evidence that the torque on the two sides of a deflection, rad, is not antisymmetric.

        It uses the motion that exists on both sides, at least LEAST_SIDE of it; infinite outside the motion.
        """
        low, high = self.domain
        if not low < place < high:
            return math.inf
        reach = max(min(place - low, high - place), c.LEAST_SIDE * (high - low))
        return self._evidence(self._series(place + reach) + self._series(place - reach) - 2.0 * self._series(place))

    def _series(self, place: float) -> Array:
        return np.array([Legendre.basis(k, self.domain)(place) for k in range(len(self.coefficients))])

    def _evidence(self, series: Array) -> float:
        variance = max(float(series @ self.covariance @ series), 0.0) + (c.RESOLVED * self.scale) ** 2
        return float(series @ self.coefficients) ** 2 / variance

    def crossing(self, order: int) -> float | None:
        """Return the deflection, rad, nearest the middle of the motion, at which a derivative of the torque is zero."""
        roots = Legendre(self.coefficients, self.domain).deriv(order).trim().roots()
        real = np.real(roots[np.isreal(roots)])
        inside = real[(real >= self.domain[0]) & (real <= self.domain[1])]
        return float(inside[np.argmin(np.abs(inside - np.mean(self.domain)))]) if inside.size else None


def _curve(signals: Signals) -> _Curve:
    """Return the static torque, fitted together with damping and friction. Raises RuntimeError if they cannot be
    distinguished.
    """
    for degree, more in pairwise(c.CURVE_DEGREES):
        richer = _fitted(signals, more)
        if (richer.coefficients**2 <= richer.limit * np.diag(richer.covariance))[degree + 1 :].all():
            return _fitted(signals, degree)
    return richer


def _fitted(signals: Signals, degree: int) -> _Curve:
    every = slice(None, None, max(1, len(signals) // c.CURVE_ROWS))
    motion, torque = signals.motion, signals.coupling_torque[every]
    angle, rate = motion.dtheta[every], motion.dtheta_dot[every]
    ends = (float(motion.dtheta.min()), float(motion.dtheta.max()))
    series = [Legendre.basis(k, ends)(angle) for k in range(degree + 1)]
    columns = np.stack([*series, rate, np.sign(rate)], axis=1)
    values = least_absolute_deviations(columns, torque).genes
    found = covariance(Blocks.of(columns, torque), values)
    if not found.distinct[: degree + 1].all():
        raise RuntimeError("the motion does not separate stiffness from damping and friction")
    own = slice(degree + 1)
    limit = math.log(len(torque)) + c.STRONG
    return _Curve(values[own], found.matrix[own, own], ends, float(np.ptp(torque)), limit)
