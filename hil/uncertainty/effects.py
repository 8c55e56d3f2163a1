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
from itertools import pairwise, product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ga.model.memory import slide_along
from ga.model.record import Mark, Parameter, Regressors, Role, Term
from ga.model.terms import SMALLEST, TERMS, compatible_model
from ga.model.trajectory import Motion
from hil.signals.angle import difference
from hil.signals.constants import DIFFERENCE, LENGTHS, SHORT_LAG, SMALL_TORQUE, SMOOTH, SOFT, TIMES
from hil.signals.rate.low_pass import transform_size

Array = NDArray[np.float64]


_SIXTH: Final = difference(DIFFERENCE)
NOISE_GAIN: Final = float(_SIXTH @ _SIXTH)
"""The variance of `reading_noise` if the deflection has white noise of variance one."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording as arrays (n,): time s, torque of the coupling N m, deflection rad, rate rad/s.

    starts: the first sample of each piece, beginning with 0; filters start anew at each piece.
    """

    time: Array
    torque: Array
    deflection: Array
    rate: Array
    starts: tuple[int, ...] = (0,)

    def __len__(self) -> int:
        return len(self.time)

    def at(self, rows: NDArray[np.int64], starts: set[int]) -> Recorded:
        """Return the samples with the rising indices `rows`.

        starts: samples among them at which additional pieces begin.
        """
        known = np.searchsorted(rows, self.starts).tolist()
        begin = tuple(sorted(start for start in {0, *starts, *known} if start < len(rows)))
        return Recorded(self.time[rows], self.torque[rows], self.deflection[rows], self.rate[rows], begin)

    def stretches(self) -> Iterator[slice]:
        """Yield the samples of each piece."""
        ends = [*(at for at in self.starts if at < len(self)), len(self)]
        return (slice(first, last) for first, last in pairwise(ends) if last > first)

    @property
    def step(self) -> float:
        """The usual time between two samples, s."""
        return float(np.median(np.diff(self.time)))

    def delayed(self, values: Array, delay: float) -> Array:
        """Return values (n,) delayed by `delay` s; the first value of each piece is also used for the time before the
        piece.
        """
        found = np.empty(len(self))
        for part in self.stretches():
            found[part] = np.interp(self.time[part] - delay, self.time[part], values[part])
        return found

    def slope(self, values: Array) -> Array:
        """Return the time derivative of values (n,)."""
        found = np.zeros(len(self))
        for part in self.stretches():
            if part.stop - part.start > 1:
                found[part] = np.gradient(values[part], self.time[part])
        return found

    def convolved(self, values: Array, weights: Array, centre: int) -> Array:
        """Return values (n,) filtered by weights (m,).

        centre: the index of the weight that acts without delay. Beyond the ends of a piece its end values are used.
        """
        found = np.empty(len(self))
        for part in self.stretches():
            padded = np.pad(values[part], (len(weights) - 1 - centre, centre), mode="edge")
            size = transform_size(len(padded) + len(weights))
            spectrum = np.fft.rfft(padded, size) * np.fft.rfft(weights, size)
            found[part] = np.fft.irfft(spectrum, size)[len(weights) - 1 :][: part.stop - part.start]
        return found

    def smoothed(self, values: Array, frequency: float) -> Array:
        """Return values (n,) low-passed at `frequency`, Hz, without phase shift (Gaussian window)."""
        width = np.sqrt(np.log(2.0)) / (2.0 * np.pi * frequency * self.step)
        half = int(np.ceil(3.0 * width))
        weights = np.exp(-0.5 * (np.arange(-half, half + 1) / width) ** 2)
        return self.convolved(values, weights / weights.sum(), half)

    def motion(self) -> Motion:
        """Return the motion, with the acceleration as the slope of the rate."""
        known = np.zeros(len(self))
        return Motion(self.time, self.deflection, self.rate, self.slope(self.rate), known, starts=self.starts)

    def centred(self) -> Array:
        """Return the deflection, rad, relative to the middle of its range."""
        return self.deflection - 0.5 * float(self.deflection.max() + self.deflection.min())

    def reach(self) -> float:
        """Return half the range of the deflection, rad."""
        return float(np.abs(self.centred()).max())

    def elapsed(self) -> Array:
        """Return the position (n,) of each sample in the whole recording, -0.5 to 0.5; the time would repeat in pooled
        recordings.
        """
        return np.linspace(-0.5, 0.5, len(self))

    def presliding(self, length: float) -> Array:
        """Return the friction state of Dahl (1976), -1 to 1, which builds up over `length` rad after a reversal."""
        moves = np.diff(self.time, prepend=self.time[0]) * self.rate
        moves[list(self.starts)] = 0.0
        keep, found = np.exp(-np.abs(moves[1:]) / length), np.zeros(len(self))
        slide_along(keep, (1.0 - keep) * np.sign(moves[1:]), found)
        return found

    @property
    def softness(self) -> float:
        """The rate, rad/s, over which friction turns."""
        return SOFT * float(np.sqrt(np.mean(self.rate**2)))

    def sign(self) -> Array:
        """Return the sign of the rate, smoothed where the rate is small."""
        return np.tanh(self.rate / self.softness) if self.softness > 0.0 else np.zeros(len(self))


Signature = Callable[[Recorded, Array], list[Array]]
"""A function that returns the columns (n, k) of an effect.

Its arguments are a recording and the torque (n,), N m, of the fitted model.
"""


@dataclass(frozen=True, slots=True)
class Effect(Mark):
    """An effect that may explain the residuals.

    terms: the terms that describe it. in_deflection: whether the effect disturbs the deflection's reading, so that it
    changes Bc through a false skew.
    """

    signature: Signature = lambda _recorded, _model: []
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


def _smooth(recorded: Recorded, values: Array) -> Array:
    """Return values (n,) without the noise of their readings, which is listed as a separate effect."""
    return recorded.smoothed(values, SMOOTH / recorded.step)


def _from_middles(recorded: Recorded) -> list[Array]:
    """Return the deflection, rad, relative to two points: where the torque is small, and the middle of its range."""
    angle, torque = recorded.centred(), np.abs(recorded.torque)
    return [angle - float(np.median(angle[torque <= np.quantile(torque, SMALL_TORQUE)])), angle]


def _grid(recorded: Recorded, parameter: Parameter) -> tuple[float, ...]:
    """Return the values of a nonlinear parameter for which the signature of its effect is computed; for a deflection,
    the middle of the range.
    """
    reach, shortest = recorded.reach(), 2.0 * recorded.step
    if parameter.kind == "relaxation time":
        return tuple(constant for constant in TIMES if constant > shortest)
    if parameter.kind == "presliding length":
        return tuple(part * reach for part in LENGTHS[1::2])
    if parameter.kind == "gap width":
        return tuple(2.0 * part * reach for part in LENGTHS)
    return (0.0 if parameter.place else max(SHORT_LAG, shortest),)


def _of_term(term: Term, recorded: Recorded, model: Array) -> Iterator[Array]:
    """Yield the columns (n, k) of a term that a model with the torque (n,), N m, lacks."""
    grids = [_grid(recorded, parameter) for parameter in term.parameters if parameter.nonlinear]
    motion, torque, contact = recorded.motion(), _smooth(recorded, model), np.ones(len(recorded))
    seen = partial(Regressors, recorded.elapsed(), motion, contact=contact, load=None, damped=True, middle=0.0)
    if term.delays:
        yield _columns(recorded.slope(torque))
    elif term.load is not None:
        yield _columns(np.abs(model - np.median(model)) * recorded.sign())
    elif term.cell is not None:
        for own in product(*grids):
            yield _columns(term.cell(motion, torque, np.array(own)) - torque)
    else:
        for angle, own in product(_angles(term, recorded), product(*grids)):
            values = np.array(own)
            if term.remaining is not None:
                yield _columns(angle - term.remaining(angle, values))
            elif term.columns is not None:
                yield _columns(*term.columns(seen(angle=angle, smoothing=recorded.softness, own=values)))


def _angles(term: Term, recorded: Recorded) -> list[Array]:
    """Return the deflection (n,), rad, from each middle that the term may have."""
    if term.role == "play" or (term.role == "curve" and term.linear):
        return _from_middles(recorded)
    return [_smooth(recorded, recorded.deflection) if term.forgets is not None else recorded.centred()]


def _marked(mark: Mark) -> Effect:
    """Return the effect of a mark of the table."""
    terms = tuple(term for term in TERMS.values() if term.mark == mark)

    def signature(recorded: Recorded, model: Array) -> list[Array]:
        return [columns for term in terms for columns in _of_term(term, recorded, model)]

    return Effect(mark.code, mark.name, mark.advice, mark.again, signature, terms)


def _periodic(recorded: Recorded, _model: Array) -> list[Array]:
    phases = [2.0 * np.pi * turns * recorded.centred() / np.ptp(recorded.deflection) for turns in (2.0, 4.0, 8.0)]
    return [_columns(np.cos(phase), np.sin(phase)) for phase in phases]


def reading_noise(recorded: Recorded) -> Array:
    """Return the part of the deflection (n,), rad, that no smooth motion makes: its sixth difference, scaled to 1 for a
    single wrong reading of 1 rad.
    """
    found = np.zeros(len(recorded))
    for part in recorded.stretches():
        values = recorded.deflection[part]
        if len(values) >= len(_SIXTH):
            found[part][3:-3] = np.convolve(values - values[0], _SIXTH, mode="valid")
    return found


def of_readings(recorded: Recorded) -> Array:
    """Return the torque (n, k) that noise of the deflection may add to the residuals, in any unit."""
    # a delay in the model takes the reading of a neighbour
    noise, smooth = (
        np.stack([recorded.delayed(values, shift * recorded.step) for shift in range(-5, 6)], axis=1)
        for values in (reading_noise(recorded), _smooth(recorded, recorded.centred()))
    )
    return np.asarray(noise - smooth @ np.linalg.lstsq(smooth, noise, rcond=None)[0])


_OF_READINGS: Final = (
    Effect(
        "damping-drift",
        "a damping that changes during the recording",
        "record for longer at one temperature, or identify parts of the recording",
        signature=lambda r, _m: [_columns(r.elapsed() * r.rate)],
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
        signature=lambda r, _m: [of_readings(r)],
        in_deflection=True,
    ),
)

_MARKS: Final = dict.fromkeys(term.mark for term in TERMS.values() if term.mark is not None)

EFFECTS: Final = (*map(_marked, _MARKS), *_OF_READINGS)
"""All effects: those of terms, in the order of the table, and those that no term describes."""


def effect_of(code: str) -> Effect:
    """Return the effect of that code."""
    return next(effect for effect in EFFECTS if effect.code == code)
