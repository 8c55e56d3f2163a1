"""Compute what errors of the deflection do to the parameters of one model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ga.model.separable import SeparableModel
from hil.signals import constants as c
from hil.signals.deflection_noise import smallest_step
from hil.signals.prepare import Signals
from hil.uncertainty.deflection.correction import DeflectionErrors, deflection_errors
from hil.uncertainty.deflection.fitted import Fitted

Array = NDArray[np.float64]


def read_with_errors(
    model: SeparableModel, signals: Signals, used: NDArray[np.bool_], values: Array, half_width: Array
) -> DeflectionErrors | None:
    """Return the effect of errors of the deflection on the exact optimum; None if the rate was recorded too.

    used (n,): the samples that the model is fitted to. values (p + q,): the exact optimum, SI. half_width (p + q,):
    half the intervals of the values, SI.
    """
    window, motion = signals.window, signals.motion
    places = [at for at, one in enumerate((*model.linear, *model.nonlinear)) if one.name in c.COUPLING]
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
            torque_count=smallest_step(signals.as_read[: c.LOOKED]),
        )
    )
