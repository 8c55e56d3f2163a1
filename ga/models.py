"""The ladder of coupling models that are linear in their parameters: each term adds columns to a regression.

torque = columns . genes. `linear` is the paper's equation 3; what else a stand shows lands in Bc when it is left out,
which is why the other terms exist. Nothing here knows how a recording came about.
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

SMOOTHING = 0.05
"""v_s of the Coulomb term as a part of the r.m.s. deflection rate.

Small enough that the term is a sign wherever the joint really moves, and large enough that the noise of a rate near
zero does not flip it. It is taken from the data because rates differ by four decades between stands.
"""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a model: its name, its SI unit and what it means."""

    name: str
    unit: str
    meaning: str


class UnknownTerm(ValueError):
    """A model names a term that there is none of; the message lists those there are."""


@dataclass(frozen=True)
class Model:
    """A sum of terms. name: canonical, such as "linear+offset+coulomb". parameters: p, in the order of the columns.

    origin: s, where the drift begins; smoothing: v_s of the Coulomb term, rad/s. None: each call takes its own data's.
    """

    name: str
    parameters: tuple[Parameter, ...]
    origin: float | None = None
    smoothing: float | None = None

    def anchored(self, time: NDArray[np.float64], dtheta_dot: NDArray[np.float64]) -> Model:
        """The same model with origin and smoothing of these data (n,), so that it is one model for every part of them.

        Needed where a recording is taken block by block, or where one part is judged by a fit to another.
        """
        return replace(self, origin=float(time[0]) if time.size else 0.0, smoothing=_smoothing(dtheta_dot))

    def columns(
        self, time: NDArray[np.float64], dtheta: NDArray[np.float64], dtheta_dot: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The columns (n, p) from time, s, deflection, rad, and its rate, rad/s, each (n,).

        Raises ValueError where the three are not vectors of one length.
        """
        if not time.shape == dtheta.shape == dtheta_dot.shape == (time.size,):
            raise ValueError(
                f"time {time.shape}, dtheta {dtheta.shape} and dtheta_dot {dtheta_dot.shape} differ in shape"
            )
        model = self if self.smoothing is not None else self.anchored(time, dtheta_dot)
        columns = [c for term in self.name.split("+") for c in _TERMS[term].columns(model, time, dtheta, dtheta_dot)]
        return np.stack(columns, axis=1).astype(np.float64, copy=False)


def parse(name: str) -> Model:
    """The model of a name such as "linear+offset+coulomb"; the order of the terms does not matter.

    Raises UnknownTerm for a term there is none of, ValueError for one named twice or where `linear` is missing.
    """
    terms = [term.strip() for term in name.split("+")]
    for term in terms:
        _refuse_unknown(term)
        if terms.count(term) > 1:
            raise ValueError(f'model "{name}": {term} is named twice')
    if "linear" not in terms:
        raise ValueError(f'model "{name}": every model begins with linear, as in "linear+{name}"')
    ordered = [term for term in _TERMS if term in terms]
    return Model("+".join(ordered), tuple(p for term in ordered for p in _TERMS[term].parameters))


def _refuse_unknown(term: str) -> None:
    if term in _TERMS:
        return
    known = ", ".join(_TERMS)
    if term in _NOT_LINEAR:
        raise UnknownTerm(f'model term "{term}" is not available yet; there are {known}')
    near = difflib.get_close_matches(term, _TERMS, n=1)
    hint = f' - did you mean "{near[0]}"?' if near else ""
    raise UnknownTerm(f'no model term "{term}"; there are {known}{hint}')


@dataclass(frozen=True, slots=True)
class _Term:
    parameters: tuple[Parameter, ...]
    columns: Callable[
        [Model, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], tuple[NDArray[np.float64], ...]
    ]


def _smoothing(rate: NDArray[np.float64]) -> float:
    return SMOOTHING * float(np.linalg.norm(rate) / np.sqrt(max(rate.size, 1)))


def _coulomb(rate: NDArray[np.float64], smoothing: float) -> NDArray[np.float64]:
    return np.tanh(rate / smoothing) if smoothing > 0.0 else np.zeros_like(rate)


_TERMS: Final[Mapping[str, _Term]] = MappingProxyType(
    {
        "linear": _Term(
            (
                Parameter("Kc", "N*m/rad", "stiffness of the coupling"),
                Parameter("Bc", "N*m*s/rad", "damping of the coupling"),
            ),
            lambda _model, _time, angle, rate: (angle, rate),
        ),
        "offset": _Term(
            (Parameter("tau0", "N*m", "torque at rest, at the first sample"),),
            lambda _model, _time, angle, _rate: (np.ones_like(angle),),
        ),
        "drift": _Term(
            (Parameter("drift", "N*m/s", "slope of the torque reading in time"),),
            # from the first sample on: an absolute time would be nearly collinear with the offset
            lambda model, time, _angle, _rate: (time - (model.origin or 0.0),),
        ),
        "coulomb": _Term(
            (Parameter("Fc", "N*m", "Coulomb friction"),),
            lambda model, _time, _angle, rate: (_coulomb(rate, model.smoothing or 0.0),),
        ),
        "cubic": _Term(
            (Parameter("K3", "N*m/rad^3", "cubic stiffness"),),
            lambda _model, _time, angle, _rate: (angle**3,),
        ),
    }
)

_NOT_LINEAR: Final = frozenset({"backlash", "slack", "skew", "inertia"})
