"""Correct the parameters for errors of the deflection: by instrumental variables, or by simulating the errors.

Noise and rounding of the deflection are in the regressors and make Kc and Bc too small. If the command was recorded, it
serves as an instrument that is free of these errors; otherwise the effect of adding the same errors once more is
simulated. Both methods use the model linearised at its exact optimum, and so correct nonlinear parameters too. Nothing
is changed if the correction is small beside the intervals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ga.arrays import Array, Mask
from ga.model.separable import SeparableModel
from hil.identification.deflection.fitted import Fitted, sampled
from hil.identification.deflection.instruments import by_command
from hil.identification.deflection.rounding import rounded_at_rest
from hil.identification.deflection.simulation import is_in_step, simulated_change
from hil.signals.constants import COUPLING, ENOUGH, FEW_COUNTS, FEWEST, NO_ERROR, SHORTEST_BLOCK, WEAK_COMMAND
from hil.signals.deflection_noise import smallest_step
from hil.signals.prepare import Signals

Method = Literal["none", "simulation", "instruments"]


@dataclass(frozen=True, eq=False)
class DeflectionErrors:
    """The errors of the deflection and their correction.

    noise: standard deviation of the readings' errors, rad. counts: the encoder counts of the motion, peak to peak.
    low_pass: corner frequency of the deflection's low-pass, Hz, None without a low-pass. method: the method of
    correction. change (p + q,): the correction added to the parameters, SI. half_width (p + q,): half the 95 % interval
    of the correction, SI, including rounding that repeats with the motion. predicted (p + q,): the correction by
    simulation, SI. strength: the strength of the command as an instrument, from 1 if the motion follows it down to 0;
    None if it was not recorded or not needed.
    """

    noise: float
    counts: float
    low_pass: float | None
    method: Method
    change: Array
    half_width: Array
    predicted: Array
    strength: float | None = None

    @property
    def is_weak(self) -> bool:
        """Return whether there is a command, but the motion does not follow it."""
        return self.strength is not None and self.strength < WEAK_COMMAND


def read_with_errors(
    model: SeparableModel, signals: Signals, used: Mask, values: Array, half_width: Array
) -> DeflectionErrors | None:
    """Return the effect of errors of the deflection on the exact optimum; None if the rate was recorded too.

    used (n,): the samples that the model is fitted to. values (p + q,): the exact optimum, SI. half_width (p + q,):
    half the intervals of the values, SI.
    """
    window, motion = signals.window, signals.motion
    places = [at for at, one in enumerate((*model.linear, *model.nonlinear)) if one.name in COUPLING]
    if window is None or not places or not np.isfinite(half_width[places]).all():
        return None
    p = len(model.linear)
    return deflection_errors(
        Fitted(
            model=model,
            motion=motion,
            torque=signals.torque,
            used=used,
            genes=values[:p],
            nonlinear=values[p:],
            half_width=half_width,
            decisive=tuple(places),
            window=window,
            command=signals.command if motion.part_of is None else None,
            torque_count=smallest_step(signals.as_read[:ENOUGH]),
        )
    )


def deflection_errors(fitted: Fitted) -> DeflectionErrors:
    """Return the effect of errors of the deflection on the parameters, and the correction."""
    part, window, nothing = fitted.part(), fitted.window, np.zeros(len(fitted.half_width))
    counts = float(np.ptp(fitted.motion.dtheta)) / window.count if window.count else np.inf
    low_pass = window.low_pass.cut if window.low_pass else None
    sound = window.sound(sampled(part.motion).time)[part.motion.whole[1]] & part.used
    rounded = rounded_at_rest(part, sound)
    found = DeflectionErrors(window.of_deflection, counts, low_pass, "none", nothing, rounded, nothing)
    if np.count_nonzero(sound) < FEWEST * SHORTEST_BLOCK or not _disturbed(part):
        return found
    simulated, spread = simulated_change(part, sound)
    if counts < 2.0 * FEW_COUNTS or (window.count and is_in_step(part, sound, spread)):
        rounded = np.maximum(rounded, spread)
    found = replace(found, predicted=simulated.values, half_width=rounded)
    instruments = by_command(part, sound)
    # noise that is not white is more than its floor says, which only the command shows
    is_shown = instruments is not None and instruments[1] >= WEAK_COMMAND and fitted.shows(instruments[0])
    if not fitted.matters(simulated.values) and not is_shown:
        return found
    if instruments is not None:
        found = replace(found, strength=instruments[1])
    if instruments is None or found.is_weak:
        half_width = np.hypot(simulated.half_width, rounded)
        return replace(found, method="simulation", change=simulated.values, half_width=half_width)
    # what the size of the errors does not explain may be errors that are not white, or a torque that the model lacks:
    # with the command in place of the motion, the latter changes the parameters
    change, unexplained = instruments[0], instruments[0].values - simulated.values
    half_width = np.hypot(np.maximum(change.half_width, np.abs(unexplained)), rounded)
    return replace(found, method="instruments", change=change.values, half_width=half_width)


def _disturbed(part: Fitted) -> bool:
    window, motion = part.window, part.motion
    passed = window.low_pass.amplification()[0] if window.low_pass else 1.0
    shares = (
        (passed * window.of_deflection) ** 2 / max(float(np.var(motion.dtheta)), 1e-300),
        window.noise**2 / max(float(np.var(motion.dtheta_dot)), 1e-300),
    )
    return max(shares) > NO_ERROR
