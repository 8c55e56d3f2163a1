"""Test for lack of fit: which part of the residuals follows from the motion, and how.

The test compares the residuals with regressors that the model lacks: Kc and Bc of one part of the samples (Chow 1960;
Hausman 1978), the earlier motion, powers, signs and products of the motion, waves over the angle, time. The part of a
regressor that the model's own columns explain is removed first. Its product with the residuals is then a score (Rao
1948), summed over blocks in time. If the model is right, the sum of each block has either sign with equal probability,
however the residuals within a block are correlated and distributed. Random signs of the blocks therefore give the
distribution of the scores by chance. Holm's (1979) correction allows for the number of tests. The size of the misfit is
the fraction of the residuals that ridge regression predicts in blocks that it was not fitted to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ga.arrays import Array, Mask
from ga.model.trajectory import Motion
from hil.identification.deflection.instruments import delayed
from hil.identification.misfit.effects import EFFECTS, NOISE_GAIN, Effect, reading_noise, smoothed
from hil.identification.misfit.outcome import LackOfFit, Respect, Suspect
from hil.identification.misfit.regressors import NAMES, cuts, mean_over_plane, regressors
from hil.identification.misfit.scores import Scores
from hil.signals import constants as c
from hil.signals.deflection_noise import skew_by_noise


@dataclass(frozen=True, slots=True)
class Residuals:
    """The residuals of the fit that is tested, SI, and its columns.

    motion, torque (n,): of the coupling, N m. residuals (n,): N m. columns (n, p): the derivative of the torque with
    respect to each parameter. coupling: the indices of Kc and Bc, None for a model without them. values: Kc and Bc.
    half_width: half their intervals. skew: the index of a skew, None if the model has none. kept (n,): the samples that
    the model describes, None for all; the other samples are ignored. included: the codes of effects that the model
    already has a term for, and which therefore are no remedy.
    """

    motion: Motion
    torque: Array
    residuals: Array
    columns: Array
    coupling: tuple[int, int] | None
    values: tuple[float, float]
    half_width: tuple[float, float]
    skew: int | None = None
    kept: Mask | None = None
    included: frozenset[str] = frozenset()


def lack_of_fit(fitted: Residuals) -> LackOfFit | None:
    """Test a fit for lack of fit. Return None if the recording is too short, or if the residuals are only rounding.

    None also if the model describes almost no sample. Raises ValueError if the arrays differ in length.
    """
    count = len(fitted.motion)
    if not count == len(fitted.residuals) == len(fitted.columns):
        raise ValueError(f"{count} samples, {len(fitted.residuals)} residuals, {len(fitted.columns)} rows")
    if count < c.FEWEST * c.SHORTEST_BLOCK or np.ptp(fitted.motion.dtheta) == 0.0:
        return None
    if fitted.kept is not None and np.count_nonzero(fitted.kept) <= fitted.columns.shape[1]:
        return None
    fitted = _zero_where_not_described(fitted)
    if float(np.std(fitted.residuals)) <= c.ROUNDED * float(np.std(fitted.torque)):
        return None
    return _Tests(_fewer(fitted)).result()


def predicted(*fits: Residuals) -> Array:
    """Return the predictable part of the residuals of each of k fits, N m r.m.s. (k,); all use the regressors of the
    first.
    """
    tests = [_Tests(_fewer(_zero_where_not_described(one))) for one in fits]
    features = np.concatenate(list(tests[0].features().values()), axis=1)
    return np.array([one.tested.predicted(features)[1] for one in tests])


class _Tests:
    """The scores of the residuals of a fit, and the lack-of-fit tests on these scores."""

    def __init__(self, fitted: Residuals) -> None:
        self._motion, self._fitted = fitted.motion, fitted
        kept = np.ones(len(fitted.motion), dtype=bool) if fitted.kept is None else fitted.kept
        self._kept = kept[:, None]
        self.tested = Scores(fitted.residuals, fitted.columns, kept)
        self._model = fitted.torque - fitted.residuals
        at = fitted.coupling
        own = fitted.columns[:, list(at)] if at else np.stack([self._motion.dtheta, self._motion.dtheta_dot], axis=1)
        self._coupling = own - own.mean(axis=0)  # where an encoder has its zero says nothing

    def features(self) -> dict[str, Array]:
        """Return the regressors (n, k) of each respect, without the part that the model's columns explain."""
        return {name: self.tested.new(values) for name, values in regressors(self._motion, self._model).items()}

    def result(self) -> LackOfFit:
        """Run all tests and return their result."""
        features = self.features()
        everything = np.concatenate(list(features.values()), axis=1)
        compared = [self._compared(*cut) for cut in cuts(self._motion)]
        found = [one for one in compared if one is not None]
        found += [Respect(code, NAMES[code], self.tested.chance(values)) for code, values in features.items()]
        found.append(Respect("any", NAMES["any"], self.tested.chance(everything)))
        respects = _corrected(found)
        share, predicted = self.tested.predicted(everything)
        suspects = self._suspects(share) if any(one.fails for one in respects) else ()
        explained = bool(suspects) and suspects[0].share >= c.AS_GOOD * share
        sizes = self._sizes(respects, suspects, predicted, explained=explained)
        lags, correlation = self._correlation()
        return LackOfFit(
            respects=respects,
            share=share,
            suspects=suspects,
            Kc=float(sizes[0]),
            Bc=float(sizes[1]),
            outside=self._outside(sizes),
            samples=len(self._motion),
            lags=lags,
            correlation=correlation,
            plane=mean_over_plane(self._motion, self.tested.clipped),
            predicted=predicted,
            unexplained=self._of_torque(share, predicted),
            at_zero=(float(self._at_zero[0]), float(self._at_zero[1])),
        )

    def _of_torque(self, share: float, predicted: float) -> float:
        """Return the size of the predicted torque relative to the torque's standard deviation, robust to outliers.

        share: the predicted fraction of the residuals' power. predicted: the predicted torque, N m r.m.s.
        """
        kept = self._kept[:, 0]
        residuals, torque = (float(np.std(one[kept])) for one in (self._fitted.residuals, self._fitted.torque))
        return min(predicted, float(np.sqrt(share)) * residuals) / torque if torque > 0.0 else 0.0

    def _compared(self, code: str, weights: Array | float) -> Respect | None:
        """Compare Kc and Bc of one part of the recording with Kc and Bc of the remaining part; None if they cannot
        be compared.

        code: of the test. weights: the part as weights (n,) of the samples, or as a frequency, Hz: then the part is the
        band below it.
        """
        own = self._coupling
        if isinstance(weights, float):
            part = np.stack([smoothed(self._motion, column, weights) for column in own.T], axis=1)
        else:
            part = own * weights[:, None]
        left = self.tested.without_model(part)
        if not (np.linalg.norm(left, axis=0) > 1e-2 * np.linalg.norm(part, axis=0)).all():
            return None
        differences = np.linalg.lstsq(left, self.tested.residuals, rcond=None)[0]
        scale = np.linalg.norm(left, axis=0) / np.sqrt(len(left))
        chance = self.tested.chance(left / scale)
        if self._fitted.coupling is None:  # the factors are of no parameter of the model
            return Respect(code, f"the torque differs {NAMES[code]}", chance)
        return Respect(code, NAMES[code], chance, *self._relative(np.asarray(differences)))

    def _suspects(self, share: float) -> tuple[Suspect, ...]:
        """Return the few effects that explain most of the predicted part of the residuals, the best first."""
        lacking = [effect for effect in EFFECTS if effect.code not in self._fitted.included]
        found = [one for effect in lacking if (one := self._suspect(effect)) is not None and self._is_possible(one)]
        most = max((one.share for one in found), default=0.0)
        least = max(c.AS_GOOD * most, c.EXPLAINS * share)
        ranked = sorted((one for one in found if one.share >= least), key=lambda one: -one.share)
        # noise has more regressors than the others, and can be made of them
        return tuple(one for at, one in enumerate(ranked) if at == 0 or not one.effect.in_deflection)[:3]

    def _is_possible(self, one: Suspect) -> bool:
        """Return whether noise of the deflection is large enough to explain the residuals that it seems to explain;
        True for other effects.
        """
        if not one.effect.in_deflection:
            return True
        noise = self._fitted.values[0] ** 2 * self._reading_noise
        return one.share * float(np.mean(self.tested.residuals**2)) <= c.MOST_NOISE * noise

    @cached_property
    def _reading_noise(self) -> float:
        """The variance, rad^2, of the noise of the deflection."""
        return float(np.var(reading_noise(self._motion))) / NOISE_GAIN

    def _suspect(self, effect: Effect) -> Suspect | None:
        power, best = float(self.tested.residuals @ self.tested.residuals), None
        for columns in effect.signature(self._motion, self._fitted.torque, self._model):
            left = self.tested.without_model(columns)
            if not (np.linalg.norm(left, axis=0) > 1e-3 * np.linalg.norm(columns, axis=0)).all():
                continue
            factors = _least_squares(left, self.tested.residuals)
            share = 1.0 - float(np.sum((self.tested.residuals - left @ factors) ** 2)) / power
            if best is not None and share <= best.share:
                continue
            moved = self._moved(effect, (columns * self._kept) @ factors)
            if effect.is_of("play") and not self._takes_spring(columns, float(factors[0]), moved[0]):
                continue
            if effect.in_deflection or self.tested.chance(left) < c.BY_CHANCE / len(EFFECTS):  # noise is always there
                best = Suspect(effect, share, *moved)
        return best

    def _takes_spring(self, columns: Array, factor: float, moved: float) -> bool:
        """Return whether the fitted coefficient of a gap's column (n, 1) is that of a gap: about -Kc.

        factor: the coefficient. moved: the relative change of Kc with the gap. In a gap of a spring that curves, a part
        of the stiffness remains. A gap narrower than the columns has a smaller coefficient.
        """
        stiffness = self._fitted.values[0] + moved * float(self._scale[0])
        if self._fitted.coupling is None:
            return True
        least, most = c.GAP_FACTOR
        narrow = float(np.abs(columns).max()) < c.NARROW_GAP * 0.5 * float(np.ptp(self._motion.dtheta))
        return (0.0 if narrow else least * stiffness) < -factor < most * stiffness

    def _moved(self, effect: Effect, torque: Array) -> tuple[float, float]:
        """Return the relative change of Kc and Bc if the effect's torque (n,) is removed from the fit."""
        if self._fitted.coupling is None:
            return 0.0, 0.0
        return self._relative(self._moved_by_noise() if effect.in_deflection else -self._of_coupling @ torque)

    @cached_property
    def _of_coupling(self) -> Array:
        """The weights (2, n) of a torque in the least-squares estimates of Kc and Bc."""
        return np.asarray(np.linalg.pinv(self._fitted.columns)[list(self._fitted.coupling or ())])

    def _moved_by_noise(self) -> Array:
        """Return the change of Kc and Bc (2,), SI, that removes the effect of noise in the deflection.

        The noise makes Kc too low. A delay by a fraction of the sampling period averages the noise, by up to a half
        midway between two readings. It therefore biases a skew in that direction as far as the residuals of the skew
        allow; Bc changes by Kc times the skew.
        """
        fitted, stiffness, noise = self._fitted, self._fitted.values[0], self._reading_noise
        attenuated = stiffness * noise / float(np.var(self._motion.dtheta))
        if fitted.skew is None:
            return np.array([attenuated, 0.0])
        others = np.delete(fitted.columns, fitted.skew, axis=1)
        column = fitted.columns[:, fitted.skew]
        alone = column - others @ np.linalg.lstsq(others, column, rcond=None)[0]
        return np.array([attenuated, stiffness * skew_by_noise(stiffness * noise**0.5, alone, self._motion.step)])

    def _relative(self, changes: Array) -> tuple[float, float]:
        """Return changes (2,) of Kc and Bc relative to `_scale`; 0 where the scale is zero."""
        first, second = np.divide(changes, self._scale, out=np.zeros(2), where=self._scale > 0.0).tolist()
        return first, second

    @property
    def _scale(self) -> Array:
        """Return the divisors (2,) for relative changes of Kc and Bc: the value, or half the interval if the value is
        zero.
        """
        values = np.abs(self._fitted.values)
        return np.where(values > 0.0, values, self._at_zero)

    @property
    def _at_zero(self) -> Array:
        """Return half the intervals of Kc and Bc (2,), SI, if they are at their bound, zero; else 0."""
        values, half_width = np.abs(self._fitted.values), np.asarray(self._fitted.half_width)
        return np.where((values == 0.0) & np.isfinite(half_width), half_width, 0.0)

    def _sizes(
        self, respects: tuple[Respect, ...], suspects: tuple[Suspect, ...], torque: float, *, explained: bool
    ) -> Array:
        """Return the size of the misfit as relative changes of Kc and Bc (2,), not negative.

        torque: the predicted torque, N m r.m.s. explained: whether the likeliest effect explains nearly all of that
        torque.
        """
        if not any(one.fails for one in respects):
            return np.zeros(2)
        # an effect that explains all explains the differences between parts too, but not what changed on the way
        compared = [one for one in respects if one.fails and (one.code == "half" or not explained)]
        # the recording cannot decide between the suspects: the one that moves them most may be there
        found = [(abs(one.Kc), abs(one.Bc)) for one in suspects]
        found += [(0.5 * abs(one.Kc), 0.5 * abs(one.Bc or 0.0)) for one in compared if one.Kc is not None]
        if found:
            return np.asarray(np.max(found, axis=0), dtype=np.float64)
        alone = np.linalg.norm(_apart(self._coupling), axis=0) / np.sqrt(len(self._coupling))
        own = self._scale * alone
        return np.asarray(np.divide(torque, own, out=np.zeros(2), where=own > 0.0))

    def _outside(self, sizes: Array) -> tuple[str, ...]:
        scale = self._scale
        beyond = sizes * scale > np.maximum(self._fitted.half_width, c.ACCURATE * scale)
        return tuple(name for name, is_beyond in zip(c.COUPLING, beyond.tolist(), strict=True) if is_beyond)

    def _correlation(self) -> tuple[Array, Array]:
        """Return lags (l,), s, and the correlation (l, 2) of the clipped residuals with deflection and rate that
        much earlier.
        """
        lags = c.LAGS
        size = float(np.linalg.norm(self.tested.clipped))
        found = [[self._alike(values, lag) / size for values in self._coupling.T] for lag in lags.tolist()]
        return lags, np.array(found)

    def _alike(self, values: Array, lag: float) -> float:
        then = delayed(self._motion, values - values.mean(), lag)
        size = float(np.linalg.norm(then))
        return float(self.tested.clipped @ then) / size if size > 0.0 else 0.0


def _fewer(fitted: Residuals) -> Residuals:
    """Return a fit with at most about `TESTED` samples: every n-th sample, or pieces spread over the
    recording.
    """
    motion = fitted.motion
    if len(motion) <= c.TESTED:
        return fitted
    speed = np.sqrt(np.mean(motion.dtheta_dot**2) / np.var(motion.dtheta))  # rad/s, of a sine that moves alike
    dense = 2.0 * np.pi / (speed * motion.step * 2.0 * c.DENSE_READINGS) if speed > 0.0 else 1.0
    rows = np.arange(0, len(motion), max(1, min(len(motion) // c.TESTED, int(dense))))
    starts = range(0)
    if len(rows) > c.TESTED:
        length = c.TESTED // c.FEWEST
        firsts = np.linspace(0, len(rows) - length, c.FEWEST).astype(int)
        rows = rows[(firsts[:, None] + np.arange(length)).ravel()]
        starts = range(0, len(rows), length)
    arrays = {name: getattr(fitted, name)[rows] for name in ("torque", "residuals", "columns")}
    kept = None if fitted.kept is None else fitted.kept[rows]
    return replace(fitted, motion=motion.alone(rows, starts), kept=kept, **arrays)


def _least_squares(columns: Array, values: Array) -> Array:
    """Return the factors (k,) of columns (n, k) that fit values (n,); one column needs no decomposition."""
    if columns.shape[1] == 1:
        return np.asarray((columns.T @ values) / np.sum(columns**2))
    return np.asarray(np.linalg.lstsq(columns, values, rcond=None)[0])


def _apart(coupling: Array) -> Array:
    """Return the part of each of two columns (n, 2) that is orthogonal to the other."""
    first, second = coupling.T
    product = float(first @ second)
    return np.stack(
        [
            first - second * product / max(float(second @ second), 1e-300),
            second - first * product / max(float(first @ first), 1e-300),
        ],
        axis=1,
    )


def _zero_where_not_described(fitted: Residuals) -> Residuals:
    """Return the fit with residuals and columns of zero at the samples that the model does not describe, so that these
    samples add nothing to sums.
    """
    if fitted.kept is None:
        return fitted
    residuals = np.where(fitted.kept, fitted.residuals, 0.0)
    return replace(fitted, residuals=residuals, columns=np.where(fitted.kept[:, None], fitted.columns, 0.0))


def _corrected(respects: list[Respect]) -> tuple[Respect, ...]:
    """Return the respects with Holm's correction for the number of tests."""
    order, worst = sorted(range(len(respects)), key=lambda at: respects[at].p), 0.0
    found = list(respects)
    for rank, at in enumerate(order):
        one = respects[at]
        worst = max(worst, min(1.0, one.p * (len(respects) - rank)))
        found[at] = Respect(one.code, one.name, worst, one.Kc, one.Bc)
    return tuple(found)
