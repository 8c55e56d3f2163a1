"""Recognise a slow ramp whose loop no model can explain, before a long search for a model."""

from __future__ import annotations

from typing import Final

import numpy as np

from ga.model.coupling import parse
from ga.model.separable import Problem, fit
from hil.errors import Untrustworthy
from hil.hysteresis_curve.branches import Torsion
from hil.hysteresis_curve.measures import measure
from hil.signals.prepare import Signals

_STIFFER: Final = 1.3
"""How many times stiffer unloading must be than loading; friction that does not grow with the load gives less."""
_MODELS: Final = ("linear+offset+backlash+dahl", "linear+cubic+offset+backlash+dahl")
"""The models of a spring, play and friction that must fail."""
_FAILS: Final = 0.014
"""The share of the largest torque (a standard deviation of 2 %), and ..."""
_NOISES: Final = 3.0
"""... the number of times the median noise of the torque that the median residual of these models must exceed."""
_ROWS: Final = 10_000
"""The number of rows that are enough to fit these models."""


def refuse_slow_ramp(signals: Signals) -> None:
    """Raise Untrustworthy for one slow ramp whose unloading is stiffer than its loading, and that spring, play and
    friction together do not explain. It takes a few seconds at most.

    The friction of such a joint grows with the load, which one ramp cannot distinguish from other effects.
    """
    motion = signals.motion
    if motion.repeats:
        return
    seconds = float(motion.time[-1] - motion.time[0])
    try:
        found = measure([Torsion("", signals.torque, motion.dtheta, seconds=seconds)])
    except Untrustworthy:  # it is not slow, or there is no loop
        return
    loading, unloading = found.loading.mean, found.stiffness.get(("unloading", "both", found.parts[-1]))
    if unloading is None or unloading.mean < _STIFFER * loading or not _fails(signals):
        return
    raise Untrustworthy(
        f"this is one slow ramp, and the joint is stiffer when it is unloaded ({unloading.mean:.4g} N m/rad) than "
        f"under load ({loading:.4g} N m/rad). No model of spring, play and friction explains that, so there is no Kc "
        "and no Bc. Measure stiffness, lost motion and play with hil hysteresis; for Kc and Bc record a chirp; or name "
        "a model with --model"
    )


def _fails(signals: Signals) -> bool:
    """Return whether none of the models explains the torque."""
    rows = slice(None, None, 1 + len(signals) // _ROWS)
    motion, torque = signals.motion.of(rows), signals.torque[rows]
    for name in _MODELS:
        model = parse(name).anchored(motion)
        problem = Problem(model, motion, torque, *model.bounds(motion, signals.band[1]))
        residuals = problem.residuals(fit(problem))
        noise = float(np.median(np.abs(np.diff(residuals)))) / 2.0**0.5
        if float(np.median(np.abs(residuals))) < max(_FAILS * float(np.abs(torque).max()), _NOISES * noise):
            return False
    return True
