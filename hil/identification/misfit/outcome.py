"""The result of the lack-of-fit tests: how the model is rejected, which effects explain the misfit, and whether it is
relevant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ga.arrays import Array
from hil.identification.misfit.effects import Effect
from hil.signals import constants as c


@dataclass(frozen=True, slots=True)
class Respect:
    """One lack-of-fit test.

    code: the test's code. p: the probability of its result by chance, corrected for the number of tests. Kc, Bc: the
    relative differences between the two compared parts; None if the test compares no parts.
    """

    code: str
    name: str
    p: float
    Kc: float | None = None
    Bc: float | None = None

    @property
    def fails(self) -> bool:
        """Return whether this test rejects the model."""
        return self.p < c.FALSE_ALARMS


@dataclass(frozen=True, slots=True)
class Suspect:
    """An effect that may explain the residuals. share: the fraction of the residuals' power that the effect explains.

    Kc, Bc: their relative change if the effect were in the model.
    """

    effect: Effect
    share: float
    Kc: float
    Bc: float


@dataclass(frozen=True, slots=True)
class Lacking:
    """The dynamic stiffness that the model lacks, relative to the whole, in a band of mean frequency, Hz."""

    frequency: float
    part: float


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """The result of the lack-of-fit tests.

    share: the fraction of the residuals' power that is predicted in unseen blocks. predicted: the predicted torque, N m
    r.m.s. unexplained: the same torque relative to the torque's standard deviation. of_noise: whether noise of the
    deflection explains the prediction. in_step: whether noise explains the prediction only because rounding repeats
    with the motion; the size of the misfit is then included in the intervals. Kc, Bc: the size of the misfit, relative:
    the largest change by a suspect, or half the difference between parts; without either, the change that would give
    the predicted torque. outside: those of the names Kc and Bc that this change takes out of their interval. at_zero:
    half the intervals of Kc and Bc, SI, if their values are zero, because changes are then relative to these; else 0.
    at_jumps: the stiffness that the model lacks in the samples beside jumps of the acceleration, to which it was not
    fitted; None if nothing relevant. An effect visible only there has no size in Kc and Bc. correlation (l, 2): the
    correlation of the residuals with deflection and rate, `lags` (l,) s earlier. plane: mean residual, N m, in cells of
    deflection (rows, rising) and rate (columns, rising) with equal numbers of samples; NaN in empty cells.
    """

    respects: tuple[Respect, ...]
    share: float
    suspects: tuple[Suspect, ...]
    Kc: float
    Bc: float
    outside: tuple[str, ...]
    samples: int
    lags: Array
    correlation: Array
    plane: Array
    predicted: float = 0.0
    unexplained: float = 0.0
    of_noise: bool = False
    in_step: bool = False
    at_zero: tuple[float, float] = (0.0, 0.0)
    at_jumps: Lacking | None = None

    def beside_noise(self, added: Array, *, counted: bool = False) -> LackOfFit:
        """Return the result with `of_noise` set, from the growth of the prediction when the errors of the motion
        double.

        added (k,): the growth of the predicted power, (N m)^2, in k simulations. If the model is wrong, the prediction
        does not grow; if errors of the motion cause it, it does (Cook and Stefanski 1994). If the motion rests or
        repeats, the growth scatters. The scatter is allowed for, unless Kc or Bc would be clearly wrong. Even then it
        is allowed for if the errors are rounding to counts (`counted`) that adds far more power at one position in the
        encoder's grid than at another.
        """
        if self.share <= 0.0:  # nothing to compare: tests of the readings themselves find their noise
            return replace(self, of_noise={one.code for one in self.failed} <= {"readings", "any"})
        mean, scatter = float(added.mean()), float(added.std(ddof=1))
        doubt = 0.0 if self._grave else c.CLEARLY * scatter
        if self._is_explained(mean + doubt):
            return replace(self, of_noise=True)
        in_step = counted and scatter > c.REPEATED_ROUNDING * mean and self._is_explained(mean + c.CLEARLY * scatter)
        return replace(self, of_noise=in_step, in_step=in_step)

    def _is_explained(self, added: float) -> bool:
        """Return whether errors of the motion explain the prediction. added: the power, (N m)^2, that they add when
        doubled.
        """
        left = self.predicted**2 - added / c.DOUBLED_ERRORS
        return left < min(c.SMALL_PART / self.share, c.MAJORITY) * self.predicted**2

    def is_far_beyond_noise(self, added: float) -> bool:
        """Return whether errors of the motion explain almost none of the torque that the test predicts.

        added: the power, (N m)^2, that the prediction gains when these errors are doubled.
        """
        return self.share > 0.0 and added < c.NOT_OF_NOISE * self.predicted**2

    @property
    def affected(self) -> str | None:
        """Return Kc or Bc: the parameter that the misfit moves out of its interval by a relevant amount.

        If it moves none out, the parameter that it changes by a relevant amount. None if both change, or neither.
        """
        worst = self._refused or self._grave
        return worst[0] if len(worst) == 1 and not self.is_of_another_joint else None

    @property
    def is_grave(self) -> bool:
        """Return whether the misfit moves Kc or Bc out of its interval by a relevant amount: 0.5 % of Kc or 3 % of Bc.

        True also for the model of another joint, whose intervals have no meaning.
        """
        return self.is_of_another_joint or bool(self._refused)

    @property
    def explains_too_little(self) -> bool:
        """Return whether a large part of the torque follows from the motion but not from the model."""
        return self.unexplained > c.OTHER_JOINT

    @property
    def is_of_another_joint(self) -> bool:
        """Return whether the model leaves most of the torque unexplained, or cannot move as fast as the joint did."""
        return self.explains_too_little or self.at_jumps is not None

    @property
    def _grave(self) -> list[str]:
        sizes = zip(("Kc", "Bc"), (self.Kc, self.Bc), self._limits(c.RELEVANT), strict=True)
        return [name for name, size, most in sizes if size > most]

    @property
    def _refused(self) -> list[str]:
        return [name for name in self._grave if name in self.outside]

    def _limits(self, relative: tuple[float, float]) -> tuple[float, float]:
        """Return the largest relative changes of Kc and Bc that are not relevant; for a value of zero, relative to half
        its interval.

        relative: the limits relative to the values.
        """
        first, second = (1.0 if half > 0.0 else most for most, half in zip(relative, self.at_zero, strict=True))
        return first, second

    def change(self, of: int, size: float) -> float:
        """Return a relative change `size` of Kc (of = 0) or Bc (of = 1) in SI units if the parameter's value is zero;
        else NaN.
        """
        return size * self.at_zero[of] if self.at_zero[of] > 0.0 else math.nan

    @property
    def failed(self) -> tuple[Respect, ...]:
        """Return the respects in which the model is rejected, the most significant first."""
        return tuple(sorted((one for one in self.respects if one.fails), key=lambda one: one.p))

    @property
    def misfit(self) -> bool:
        """Return whether the model is rejected, and its misfit is relevant.

        True also for the model of another joint, whatever the tests say.
        """
        if self.is_of_another_joint:
            return True
        if self.of_noise or not self.failed:
            return False
        if self._is_small:
            return self.share >= c.PLAIN_MISFIT and self.unexplained > c.ACCURATE and not self._is_harmless
        if self._has_unknown_size:
            return False
        return bool(self.outside) or (self.share >= c.SMALL_PART and not self._is_harmless)

    @property
    def is_undecided(self) -> bool:
        """Return whether no test rejects the model although its residuals are predictable, because there are too few
        independent samples.
        """
        return not self.failed and not self.misfit and self.share >= c.PLAIN_MISFIT

    @property
    def in_intervals(self) -> tuple[float, float]:
        """Return the relative amounts by which the intervals of Kc and Bc grow because of the misfit."""
        grows = self.misfit or self.in_step or self._is_small or self._has_unknown_size
        return (self.Kc, self.Bc) if grows else (0.0, 0.0)

    @property
    def _is_small(self) -> bool:
        """Return whether the misfit is smaller than the errors of real sensors, in Kc and Bc or in the torque."""
        first, second = self._limits(c.SMALL_MISFIT)
        return (self.Kc <= first and self.Bc <= second) or self.unexplained <= c.ACCURATE

    @property
    def _has_unknown_size(self) -> bool:
        """Return whether the motion predicts less than 2 % of the residuals' power, and neither an effect nor a
        difference between parts of the recording shows a change of Kc or Bc.

        The size of the misfit is then the largest change that so much torque could cause; it is added to the intervals,
        without a warning.
        """
        is_unsized = not self.suspects and all(one.Kc is None for one in self.failed)
        return bool(self.failed) and not self.of_noise and self.share < c.SMALL_PART and is_unsized and not self._grave

    @property
    def _is_harmless(self) -> bool:
        """Return whether the misfit is noise of the deflection that changes neither Kc nor Bc by a relevant amount."""
        return bool(self.suspects) and self.suspects[0].effect.in_deflection and not self._grave
