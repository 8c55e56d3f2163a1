"""The model of the coupling: a sum of terms (`ga.model.terms`).

torque = known + columns(nonlinear parameters) . genes. `linear` is the paper's equation 3. A term that is left out but
present lands in Bc, which is why the others exist. Nothing here knows how a recording came about.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from ga.model.terms import TERMS, Parameter, Regressors, Term, canonical

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

STUCK: Final = 0.075
"""Part of the samples, the slowest, in which friction may hold the joint and its sign is not known."""

BESIDE: Final = 0.25
"""Part of the time between two samples by which the skew may be wrong when those are determined."""

NOISY: Final = 0.5
FINEST: Final = 0.001
SMOOTHEST: Final = 0.05
"""v_s of the Coulomb term as a part of the rate's noise, at least and at most these parts of the r.m.s. rate: a sign
where friction slides, for 1.3 % of softness takes as much off Bc."""


@dataclass(frozen=True)
class CouplingModel:
    """A sum of terms. name: canonical, such as "linear+offset+coulomb+skew".

    origin: s, where the drift begins; slowest: rad/s, below which friction may hold the joint; smoothing: v_s of the
    Coulomb term, rad/s. None: each call takes its own data's.
    """

    name: str
    origin: float | None = None
    slowest: float | None = None
    smoothing: float | None = None

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """The records of its terms."""
        return tuple(TERMS[name] for name in self.name.split("+"))

    @cached_property
    def linear(self) -> tuple[Parameter, ...]:
        """The parameters (p,) of the columns, in their order."""
        return tuple(parameter for term in self.terms if term.linear for parameter in term.parameters)

    @cached_property
    def nonlinear(self) -> tuple[Parameter, ...]:
        """The parameters (q,) that the columns depend on."""
        return tuple(parameter for term in self.terms if not term.linear for parameter in term.parameters)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters: the linear, then the nonlinear ones."""
        return self.linear + self.nonlinear

    @property
    def sticks(self) -> bool:
        """Whether friction may hold the joint: then its torque is anything between -Fc and Fc."""
        return any(term.sticks for term in self.terms)

    @property
    def unilateral(self) -> bool:
        """Whether the flanks can only push: where damping would make them pull, they part."""
        return any(term.unilateral for term in self.terms)

    def anchored(self, motion: Motion) -> CouplingModel:
        """Return the model with origin and slowest rate of this motion, so that it is one model for every part of it.

        Needed where a recording is taken block by block, or where one part is validated by a fit to another.
        """
        slowest = _slowest(motion)
        origin = float(motion.time[0]) if len(motion) else 0.0
        return replace(self, origin=origin, slowest=slowest, smoothing=_smoothing(motion))

    def described(self, motion: Motion, delay: float = 0.0) -> NDArray[np.bool_]:
        """Return which samples (n,) the model describes: all but those that friction may hold the joint in.

        delay: s, how much older the torque reading is. If the model estimates it, samples next to a reversal are left
        out as well, because the sign of their friction would decide it.
        """
        if not self.sticks:
            return np.ones(len(motion), dtype=bool)
        slowest = _slowest(motion) if self.slowest is None else self.slowest
        delays = any(term.delays for term in self.terms)
        beside = BESIDE * float(np.median(np.diff(motion.time))) if delays and len(motion) > 1 else 0.0
        rates = [motion.delayed(delay + shift).dtheta_dot for shift in (-beside, 0.0, beside)]
        least, most = np.min(rates, axis=0), np.max(rates, axis=0)
        return np.asarray((least >= slowest) | (most <= -slowest))

    def delay(self, nonlinear: Array | None) -> float:
        """Return how much older the torque reading is, s, for nonlinear parameters (q,); 0 if no term says."""
        return next((float(values[0]) for term, values in self._valued(nonlinear) if term.delays), 0.0)

    def columns(self, motion: Motion, nonlinear: Array | None = None, lag: float = 0.0) -> Array:
        """Return the columns (n, p) for nonlinear parameters (q,), SI; None: for those terms left out.

        lag: Bc/Kc, s, which decides when flanks that can only push part.
        """
        model = self if self.smoothing is not None else self.anchored(motion)
        return model._stacked(model._regressors(motion, nonlinear, lag))

    def target(self, motion: Motion, torque: Array, nonlinear: Array | None = None) -> Array:
        """Return what the columns are to make up, (n,) N m: the torque (n,) without what is known of it."""
        return np.asarray(torque - motion.delayed(self.delay(nonlinear)).known)

    def jacobian(
        self, motion: Motion, nonlinear: Array, genes: Array, lag: float = 0.0, *, changing: Motion | None = None
    ) -> Array:
        """Return how the torque changes with each nonlinear parameter: (n, q), N m per unit, at (q,) and genes (p,).

        changing: how fast the motion changes, per second; None: interpolated. Where flanks meet, the damping torque
        jumps, and where the joint turns, its friction; what that adds at single samples is left out.
        """
        model = self if self.smoothing is not None else self.anchored(motion)
        regressors = model._regressors(motion, nonlinear, lag)
        found: list[Array] = []
        for term in self.terms:
            if term.delays:
                rates = motion.changing(self.delay(nonlinear)) if changing is None else changing
                found.append(-(model._stacked(regressors, rates) @ genes + rates.known))
            elif term.shifts is not None:
                stiffness = model._stiffness(regressors, genes)
                found += [-stiffness * shift * regressors.contact for shift in term.shifts(regressors.angle)]
        return np.stack(found, axis=1) if found else np.empty((len(motion), 0))

    def bounds(self, motion: Motion, highest: float) -> tuple[Array, Array]:
        """Return low (q,) and high (q,) of the nonlinear parameters, for motion up to `highest` Hz."""
        pairs = [pair for term in self.terms if term.bounds is not None for pair in term.bounds(motion, highest)]
        return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])

    def _valued(self, nonlinear: Array | None) -> Iterator[tuple[Term, Array]]:
        """Each nonlinear term with its own of the parameters (q,)."""
        at = 0
        for term in self.terms if nonlinear is not None else ():
            if not term.linear and nonlinear is not None:
                yield term, nonlinear[at : at + len(term.parameters)]
                at += len(term.parameters)

    def _regressors(self, motion: Motion, nonlinear: Array | None, lag: float = 0.0) -> Regressors:
        """The motion as the torque reading saw it, beyond the gap or slack."""
        seen = motion.delayed(self.delay(nonlinear))
        angle, contact = seen.dtheta, np.ones(len(motion))
        for term, values in self._valued(nonlinear):
            if term.remaining is not None:
                angle = term.remaining(angle, values)
        if self.unilateral:
            contact = (angle * (angle + lag * seen.dtheta_dot) > 0.0).astype(np.float64)
            angle = angle * contact
        return Regressors(motion.time - (self.origin or 0.0), seen, angle, contact, self.smoothing or 0.0)

    def _stiffness(self, regressors: Regressors, genes: Array) -> Array:
        """How the torque changes with the deflection, N m/rad, for genes (p,)."""
        parts, at = [], 0
        for term in self.terms:
            if term.stiffness is not None:
                parts.append(term.stiffness(regressors, genes[at : at + len(term.parameters)]))
            at += len(term.parameters) if term.linear else 0
        return np.asarray(sum(parts[1:], start=parts[0]))

    def _stacked(self, regressors: Regressors, changing: Motion | None = None) -> Array:
        """The columns, or how fast they change in time."""
        columns: list[Array] = []
        for term in self.terms:
            if term.columns is not None and changing is None:
                columns += term.columns(regressors)
            elif term.rates is not None and changing is not None:
                columns += term.rates(regressors, changing)
        return np.stack(columns, axis=1).astype(np.float64, copy=False)


def parse(name: str) -> CouplingModel:
    """Return the model of a name such as "linear+offset+coulomb"; the order of the terms does not matter.

    Raises ValueError as `ga.model.terms.canonical`.
    """
    return CouplingModel(canonical(name))


def _slowest(motion: Motion) -> float:
    """The rate, rad/s, below which friction may hold the joint; zero where the rate's noise hides which samples are.

    It is taken from the data because rates differ by four decades between stands.
    """
    slowest = float(np.quantile(np.abs(motion.dtheta_dot), STUCK)) if len(motion) else 0.0
    return slowest if slowest > (motion.rate_noise or 0.0) else 0.0


def _smoothing(motion: Motion) -> float:
    """v_s, rad/s, of the Coulomb term."""
    if not len(motion):
        return 0.0
    usual = float(np.linalg.norm(motion.dtheta_dot) / np.sqrt(len(motion)))
    return float(np.clip(NOISY * (motion.rate_noise or 0.0), FINEST * usual, SMOOTHEST * usual))
