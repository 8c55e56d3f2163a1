"""The signatures of effects that a model of the coupling may lack: columns that are compared with residuals.

For one recording, each effect gives the torque that one unit of the effect would add: the pattern of a Maxwell branch,
an inertia or friction in proportion to the torque in the residuals. The signature of a term follows from its record;
effects with a time constant or a length have a column for each of a few values. Effects of the readings that no term
describes have a signature of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Final

import numpy as np

from ga.arrays import Array
from ga.model.record import Mark, Parameter, Regressors, Role, Term
from ga.model.sticking import FULL
from ga.model.terms import SMALLEST, TERMS, compatible_model
from ga.model.trajectory import Motion
from hil.identification.deflection.instruments import delayed
from hil.signals import constants as c
from hil.signals.angle import difference

_SIXTH: Final = difference(c.DIFFERENCE)
NOISE_GAIN: Final = float(_SIXTH @ _SIXTH)
"""The variance of `reading_noise` if the deflection has white noise of variance one."""


def centred(motion: Motion) -> Array:
    """Return the deflection (n,), rad, relative to the middle of its range."""
    return motion.dtheta - 0.5 * float(motion.dtheta.max() + motion.dtheta.min())


def smoothed(motion: Motion, values: Array, frequency: float) -> Array:
    """Return values (n,) low-passed at `frequency`, Hz, without phase shift (Gaussian window)."""
    width = np.sqrt(np.log(2.0)) / (2.0 * np.pi * frequency * motion.step)
    weights = np.exp(-0.5 / (width * width) * np.arange(-int(np.ceil(3.0 * width)), int(np.ceil(3.0 * width)) + 1) ** 2)
    weights /= weights.sum()
    return motion.by_piece(lambda _time, own: _weighed(own, weights), values)


def _weighed(values: Array, weights: Array) -> Array:
    """Return the sums (n,) of values and their neighbours, weighted symmetrically (the same as scipy.ndimage to the
    last bit, without its slow import).
    """
    reach, count = len(weights) // 2, len(values)
    around = np.pad(values, reach, mode="edge")
    found: Array = values * weights[reach]
    for k in range(reach):
        found += (around[k : k + count] + around[2 * reach - k : 2 * reach - k + count]) * weights[k]
    return found


def direction(motion: Motion) -> Array:
    """Return the sign (n,) of the rate, smoothed where the rate is small."""
    softness = _softness(motion)
    return np.tanh(motion.dtheta_dot / softness) if softness > 0.0 else np.zeros(len(motion))


def progress(motion: Motion) -> Array:
    """Return the position (n,) of each sample, -0.5 to 0.5; the time would repeat in pooled recordings."""
    return np.linspace(-0.5, 0.5, len(motion))


def _softness(motion: Motion) -> float:
    """Return the rate, rad/s, over which friction turns."""
    return FULL * float(np.sqrt(np.mean(motion.dtheta_dot**2)))


Signature = Callable[[Motion, Array, Array], list[Array]]
"""A function that returns the columns (n, k) of an effect.

Its arguments are the motion, the measured torque (n,) and the torque (n,) of the fitted model, N m.
"""


@dataclass(frozen=True, slots=True)
class Effect(Mark):
    """An effect that may explain the residuals.

    terms: the terms that describe it. in_deflection: whether the effect disturbs the deflection's reading, so that it
    changes Bc through a false skew.
    """

    signature: Signature = lambda _motion, _torque, _model: []
    terms: tuple[Term, ...] = ()
    in_deflection: bool = False

    def is_of(self, role: Role) -> bool:
        """Return whether a term of this role describes the effect."""
        return any(term.role == role for term in self.terms)

    def is_in(self, names: Sequence[str]) -> bool:
        """Return whether a model with parameters of these names leaves nothing of the effect."""
        return not self.again and any(term.parameters[0].name in names for term in self.terms)

    def remedy(self, terms: Sequence[str] = tuple(SMALLEST.split("+"))) -> str:
        """Return the advice for a model of these terms; each term in braces is combined with those of `terms` that it
        does not exclude.

        Advice that gives the present model again is left out.
        """
        models = {name: compatible_model(name, terms) for name in TERMS}
        for name, one in TERMS.items():
            if one.mark and one.mark.again and one.mark.code == self.code and name in terms:  # then there is another
                further = (other for other, more in TERMS.items() if more.needs == name and more.role == one.role)
                models[name] = next((compatible_model(other, terms) for other in further), models[name])
        return self.advice.format_map(models).removeprefix(f"try --model {'+'.join(terms)}, ")

    def __reduce__(self) -> tuple[Callable[[str], Effect], tuple[str]]:
        """Pickle the effect as its code, because its signature may be a lambda."""
        return effect_of, (self.code,)


def _columns(*columns: Array) -> Array:
    return np.stack(columns, axis=1)


def _smooth(motion: Motion, values: Array) -> Array:
    """Return values (n,) without the noise of their readings, which is listed as a separate effect."""
    return smoothed(motion, values, 1.0 / c.DENSE_READINGS / motion.step)


def _grid(motion: Motion, parameter: Parameter) -> tuple[float, ...]:
    """Return the values of a nonlinear parameter for which the signature of its effect is computed; for a deflection,
    the middle of the range.
    """
    reach, shortest = 0.5 * float(np.ptp(motion.dtheta)), 2.0 * motion.step
    if parameter.kind == "relaxation time":
        return tuple(constant for constant in c.TIMES if constant > shortest)
    if parameter.kind == "presliding length":
        return tuple(part * reach for part in c.LENGTHS[1::2])
    if parameter.kind == "gap width":
        return tuple(2.0 * part * reach for part in c.LENGTHS)
    return (0.0 if parameter.place else max(c.SHORT_LAG, shortest),)


def _of_term(term: Term, motion: Motion, measured: Array, modelled: Array) -> Iterator[Array]:
    """Yield the columns (n, k) of a term that a model lacks. measured, modelled (n,): torque, N m."""
    grids = [_grid(motion, parameter) for parameter in term.parameters if parameter.nonlinear]
    regressors = partial(
        Regressors, progress(motion), motion, contact=np.ones(len(motion)), load=None, damped=True, middle=0.0,
        smoothing=_softness(motion),
    )  # fmt: skip
    if term.delays:
        yield _columns(motion.slope(_smooth(motion, modelled)))
    elif term.load is not None:
        yield _columns(np.abs(modelled - np.median(modelled)) * direction(motion))
    elif term.cell is not None:
        smooth = _smooth(motion, modelled)
        for own in product(*grids):
            yield _columns(term.cell(motion, smooth, np.array(own)) - smooth)
    else:
        for angle, own in product(_angles(term, motion, measured), product(*grids)):
            values = np.array(own)
            if term.remaining is not None:
                yield _columns(angle - term.remaining(angle, values))
            elif term.columns is not None:
                yield _columns(*term.columns(regressors(angle=angle, own=values)))


def _angles(term: Term, motion: Motion, torque: Array) -> list[Array]:
    """Return the deflection (n,), rad, from each middle that the term may have: that of the range, and where the torque
    is small.
    """
    angle, size = centred(motion), np.abs(torque)
    if term.role == "play" or (term.role == "curve" and term.linear):
        return [angle - float(np.median(angle[size <= np.quantile(size, c.SMALL_TORQUE)])), angle]
    return [_smooth(motion, motion.dtheta) if term.forgets is not None else angle]


def _marked(mark: Mark) -> Effect:
    """Return the effect of a mark of the table."""
    terms = tuple(term for term in TERMS.values() if term.mark == mark)

    def signature(motion: Motion, torque: Array, model: Array) -> list[Array]:
        return [columns for term in terms for columns in _of_term(term, motion, torque, model)]

    return Effect(mark.code, mark.name, mark.advice, mark.again, signature, terms)


def _periodic(motion: Motion, _torque: Array, _model: Array) -> list[Array]:
    phases = [2.0 * np.pi * turns * centred(motion) / np.ptp(motion.dtheta) for turns in (2.0, 2.0**2, 2.0**3)]
    return [_columns(np.cos(phase), np.sin(phase)) for phase in phases]


def reading_noise(motion: Motion) -> Array:
    """Return the part of the deflection (n,), rad, that no smooth motion makes: its sixth difference, scaled to 1 for a
    single wrong reading of 1 rad.
    """

    def rough(_time: Array, own: Array) -> Array:
        inner = np.convolve(own - own[0], _SIXTH, mode="valid") if len(own) >= len(_SIXTH) else np.zeros(0)
        return np.pad(inner, (len(own) - len(inner)) // 2) if len(inner) else np.zeros(len(own))

    return motion.by_piece(rough, motion.dtheta)


def of_readings(motion: Motion) -> Array:
    """Return the torque (n, k) that noise of the deflection may add to the residuals, in any unit."""
    shifts = range(-c.NEAR_READINGS, c.NEAR_READINGS + 1)  # a delay in the model takes the reading of a neighbour
    noise, smooth = (
        np.stack([delayed(motion, values, shift * motion.step) for shift in shifts], axis=1)
        for values in (reading_noise(motion), _smooth(motion, centred(motion)))
    )
    return np.asarray(noise - smooth @ np.linalg.lstsq(smooth, noise, rcond=None)[0])


_OF_READINGS: Final = (
    Effect(
        "damping-drift",
        "a damping that changes during the recording",
        "record for longer at one temperature, or identify parts of the recording",
        signature=lambda motion, _t, _m: [_columns(progress(motion) * motion.dtheta_dot)],
    ),
    Effect(
        "periodic",
        "a torque that repeats with the angle: cogging, or an encoder out of centre",
        "record over a larger angle, and calibrate the encoder",
        signature=_periodic,
    ),
    Effect(
        "deflection-noise",
        "noise or counts in the deflection",
        "use a larger amplitude or a finer encoder, or name a --model without skew",
        signature=lambda motion, _t, _m: [of_readings(motion)],
        in_deflection=True,
    ),
)

_MARKS: Final = dict.fromkeys(term.mark for term in TERMS.values() if term.mark is not None)

EFFECTS: Final = (*map(_marked, _MARKS), *_OF_READINGS)
"""All effects: those of terms, in the order of the table, and those that no term describes."""


def effect_of(code: str) -> Effect:
    """Return the effect of that code."""
    return next(effect for effect in EFFECTS if effect.code == code)
