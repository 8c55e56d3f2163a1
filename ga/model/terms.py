"""The ladder of coupling models: terms that add up to the torque.

torque = known + columns(shape) . genes. `linear` is the paper's equation 3. What else a stand shows lands in Bc when it
is left out, which is why the other terms exist. Most add a column, whose factor is solved for exactly; skew, gap and
slack shape the columns instead, and are searched. Nothing here knows how a recording came about.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

STUCK: Final = 0.075
"""Part of the samples, the slowest, in which friction may hold the joint and its sign says nothing."""

BESIDE: Final = 0.25
"""Part of the time between two samples by which the skew may be wrong when those are told."""

NOISY: Final = 0.5
FINEST: Final = 0.001
SMOOTHEST: Final = 0.05
"""v_s of the Coulomb term as a part of the rate's noise, at least and at most these parts of the r.m.s. rate: a sign
where friction slides, for 1.3 % of softness takes as much off Bc."""

LONGEST_SKEW: Final = 0.02
"""s between two readings of one tick, at most."""

WIDEST_GAP: Final = 0.95
"""Part of the whole deflection that a gap or slack may take."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a model: its name, its SI unit and what it means. scales: in proportion to the torque's."""

    name: str
    unit: str
    meaning: str
    scales: bool = True


class UnknownTerm(ValueError):
    """A model names a term that there is none of; the message lists those there are."""


@dataclass(frozen=True)
class Model:
    """A sum of terms. name: canonical, such as "linear+offset+coulomb+skew".

    linear: the parameters (p,) of the columns, in their order. shape: those (q,) that shape the columns.
    origin: s, where the drift begins; slowest: rad/s, below which friction may hold the joint; smoothing: v_s of the
    Coulomb term, rad/s. None: each call takes its own data's.
    """

    name: str
    linear: tuple[Parameter, ...]
    shape: tuple[Parameter, ...] = ()
    origin: float | None = None
    slowest: float | None = None
    smoothing: float | None = None

    @property
    def terms(self) -> tuple[str, ...]:
        """The names of its terms."""
        return tuple(self.name.split("+"))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters: those of the columns, then those that shape them."""
        return self.linear + self.shape

    def anchored(self, motion: Motion) -> Model:
        """The same model with origin and slowest rate of this motion, so that it is one model for every part of it.

        Needed where a recording is taken block by block, or where one part is judged by a fit to another.
        """
        slowest = _slowest(motion)
        origin = float(motion.time[0]) if len(motion) else 0.0
        return replace(self, origin=origin, slowest=slowest, smoothing=_smoothing(motion))

    def told(self, motion: Motion, skew: float = 0.0) -> NDArray[np.bool_]:
        """The samples (n,) that the model says something about: with Coulomb friction not those it may hold a joint in.

        There its torque is anything between -Fc and Fc. skew: s, how much older the torque reading is; where the model
        has one, samples next to a reversal are left out as well, whose sign would say what the skew is.
        """
        if "Fc" not in self:
            return np.ones(len(motion), dtype=bool)
        slowest = _slowest(motion) if self.slowest is None else self.slowest
        beside = BESIDE * float(np.median(np.diff(motion.time))) if "skew" in self and len(motion) > 1 else 0.0
        rates = [motion.delayed(skew + shift).dtheta_dot for shift in (-beside, 0.0, beside)]
        least, most = np.min(rates, axis=0), np.max(rates, axis=0)
        return np.asarray((least >= slowest) | (most <= -slowest))

    @property
    def lets_go(self) -> bool:
        """Whether the coupling has flanks that can push only: where damping would make them pull, they part."""
        return bool({"gap", "slack"} & set(self._names))

    def columns(self, motion: Motion, shape: Array | None = None, lag: float = 0.0) -> Array:
        """The columns (n, p) for the shape parameters (q,), SI; None: all zero.

        lag: Bc/Kc, s, which says when flanks that can push only let go.
        """
        model = self if self.smoothing is not None else self.anchored(motion)
        return model._stacked(model._engaged(motion, shape, lag), changing=None)

    def target(self, motion: Motion, torque: Array, shape: Array | None = None) -> Array:
        """What the columns are to make up, (n,) N m: the torque (n,) without what is known of it."""
        return np.asarray(torque - motion.delayed(self._of("skew", shape)).known)

    def slopes(self, motion: Motion, shape: Array, genes: Array, lag: float = 0.0) -> Array:
        """How the torque changes with each shape parameter: (n, q), N m per unit, at shape (q,) and genes (p,).

        Where flanks meet the damping torque jumps, and where the joint turns its friction; what that adds at single
        samples is left out.
        """
        model = self if self.smoothing is not None else self.anchored(motion)
        engaged = model._engaged(motion, shape, lag)
        found = []
        for parameter in self.shape:
            if parameter.name == "skew":
                changing = motion.changing(self._of("skew", shape))
                found.append(-(model._stacked(engaged, changing) @ genes + changing.known))
            else:
                stiffness = genes[0] + (3.0 * genes[self._index("K3")] * engaged.angle**2 if "K3" in self else 0.0)
                moved = 0.5 * np.sign(engaged.angle) if parameter.name == "gap" else np.ones(len(motion))
                found.append(-stiffness * moved * engaged.touching)
        return np.stack(found, axis=1) if found else np.empty((len(motion), 0))

    def bounds(self, motion: Motion, highest: float) -> tuple[Array, Array]:
        """Where each shape parameter can be: low (q,) and high (q,), for motion up to `highest` Hz."""
        low, high = [], []
        for parameter in self.shape:
            if parameter.name == "skew":
                longest = min(LONGEST_SKEW, 0.25 / highest)  # a quarter of the shortest period: beyond it, none is told
                low.append(-longest)
                high.append(longest)
            else:
                least, span = float(motion.dtheta.min()), float(np.ptp(motion.dtheta))
                low.append({"gap": 0.0, "centre": least, "slack": least}[parameter.name])
                high.append(
                    {"gap": WIDEST_GAP * span, "centre": least + span}.get(parameter.name, least + WIDEST_GAP * span)
                )
        return np.array(low), np.array(high)

    def __contains__(self, parameter: str) -> bool:
        return any(known.name == parameter for known in self.parameters)

    def _index(self, parameter: str) -> int:
        return [known.name for known in self.parameters].index(parameter)

    def _of(self, parameter: str, shape: Array | None) -> float:
        if shape is None or parameter not in self:
            return 0.0
        return float(shape[self._index(parameter) - len(self.linear)])

    def _engaged(self, motion: Motion, shape: Array | None, lag: float = 0.0) -> _Engaged:
        """The motion as the torque reading saw it, beyond the gap or slack."""
        seen = motion.delayed(self._of("skew", shape))
        angle = seen.dtheta
        if "gap" in self:
            angle = angle - self._of("centre", shape)
            angle = np.sign(angle) * np.maximum(np.abs(angle) - 0.5 * self._of("gap", shape), 0.0)
        elif "slack" in self and shape is not None:
            angle = np.maximum(angle - self._of("slack", shape), 0.0)
        touching = np.ones(len(motion))
        if self.lets_go:
            touching = (angle * (angle + lag * seen.dtheta_dot) > 0.0).astype(np.float64)
            angle = angle * touching
        return _Engaged(motion.time - (self.origin or 0.0), seen, angle, touching, self.smoothing or 0.0)

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.shape)

    def _stacked(self, engaged: _Engaged, changing: Motion | None) -> Array:
        """The columns, or how they change in time."""
        columns = [
            column
            for term in self.terms
            if term in _COLUMNS
            for column in (
                _COLUMNS[term].columns(engaged) if changing is None else _COLUMNS[term].changing(engaged, changing)
            )
        ]
        return np.stack(columns, axis=1).astype(np.float64, copy=False)


@dataclass(frozen=True, slots=True)
class _Engaged:
    """What the columns are made of: time s since the origin, the motion as the torque saw it, the deflection (n,) rad
    beyond the gap and whether (n,) it is beyond, v_s rad/s."""

    time: Array
    seen: Motion
    angle: Array
    touching: Array
    smoothing: float


def parse(name: str) -> Model:
    """The model of a name such as "linear+offset+coulomb"; the order of the terms does not matter.

    Raises UnknownTerm for a term there is none of, ValueError for one named twice, where `linear` is missing or where
    two exclude each other.
    """
    terms = [term.strip() for term in name.split("+")]
    for term in terms:
        _refuse_unknown(term)
        if terms.count(term) > 1:
            raise ValueError(f'model "{name}": {term} is named twice')
    if "linear" not in terms:
        raise ValueError(f'model "{name}": every model begins with linear, as in "linear+{name}"')
    if {"backlash", "slack"} <= set(terms):
        raise ValueError(f'model "{name}": a single tendon (slack) has no second flank (backlash): leave one out')
    return _model([term for term in TERMS if term in terms])


def _model(terms: list[str]) -> Model:
    linear = tuple(p for term in terms if term in _COLUMNS for p in _COLUMNS[term].parameters)
    return Model("+".join(terms), linear, tuple(p for term in terms if term in _SHAPES for p in _SHAPES[term]))


def _refuse_unknown(term: str) -> None:
    if term in TERMS:
        return
    near = difflib.get_close_matches(term, TERMS, n=1)
    hint = f' - did you mean "{near[0]}"?' if near else ""
    raise UnknownTerm(f'no model term "{term}"; there are {", ".join(TERMS)}{hint}')


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


@dataclass(frozen=True, slots=True)
class _Columns:
    """A term that adds columns. changing: how fast they change in time, per second."""

    parameters: tuple[Parameter, ...]
    columns: Callable[[_Engaged], tuple[Array, ...]]
    changing: Callable[[_Engaged, Motion], tuple[Array, ...]]


def _sign(rate: Array, smoothing: float) -> Array:
    return np.tanh(rate / smoothing) if smoothing > 0.0 else np.zeros_like(rate)


_COLUMNS: Final[Mapping[str, _Columns]] = MappingProxyType(
    {
        "linear": _Columns(
            (
                Parameter("Kc", "N*m/rad", "stiffness of the coupling"),
                Parameter("Bc", "N*m*s/rad", "damping of the coupling"),
            ),
            lambda e: (e.angle, e.seen.dtheta_dot * e.touching),
            lambda e, c: (c.dtheta * e.touching, c.dtheta_dot * e.touching),
        ),
        "offset": _Columns(
            (Parameter("tau0", "N*m", "torque at rest, at the first sample"),),
            lambda e: (np.ones_like(e.angle),),
            lambda e, _c: (np.zeros_like(e.angle),),
        ),
        "drift": _Columns(
            (Parameter("drift", "N*m/s", "slope of the torque reading in time"),),
            # from the first sample on: an absolute time would be nearly collinear with the offset
            lambda e: (e.time,),
            lambda e, _c: (np.zeros_like(e.angle),),
        ),
        "coulomb": _Columns(
            (Parameter("Fc", "N*m", "Coulomb friction"),),
            lambda e: (_sign(e.seen.dtheta_dot, e.smoothing),),
            lambda e, _c: (np.zeros_like(e.angle),),
        ),
        "cubic": _Columns(
            (Parameter("K3", "N*m/rad^3", "cubic stiffness"),),
            lambda e: (e.angle**3,),
            lambda e, c: (3.0 * e.angle**2 * c.dtheta,),
        ),
        "inertia": _Columns(
            (Parameter("J", "kg*m^2", "inertia that moves with the deflection"),),
            lambda e: (e.seen.dtheta_ddot,),
            lambda _e, c: (c.dtheta_ddot,),
        ),
    }
)

_SHAPES: Final[Mapping[str, tuple[Parameter, ...]]] = MappingProxyType(
    {
        "backlash": (
            Parameter("gap", "rad", "play of the coupling, its whole width", scales=False),
            Parameter("centre", "rad", "deflection in the middle of the play", scales=False),
        ),
        "slack": (Parameter("slack", "rad", "deflection before the tendon pulls", scales=False),),
        "skew": (Parameter("skew", "s", "how much older the torque reading is than that of the angle", scales=False),),
    }
)

TERMS: Final = (*_COLUMNS, *_SHAPES)
