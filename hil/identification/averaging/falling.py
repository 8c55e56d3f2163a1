"""The fits of the largest model with friction that falls with the rate.

Friction may fall with the rate, as that of grease and of soft bristles does (Stribeck 1902; Canudas de Wit and others
1995): it then takes from the torque what damping adds. Over which rate it falls is not known, nor by how much, up to as
much as it is at speed: models in which it does, over each of a few of the rates driven, weigh as one with a parameter
more. Where the recording hardly shows the fall, its size is limited by that alone.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ga.lad.exact import least_absolute_deviations
from ga.model.friction import felt
from ga.model.memory import falls
from ga.model.terms import PARAMETERS
from ga.model.trajectory import Motion
from hil.identification.averaging.largest import Largest
from hil.identification.selection.criterion import by_rate, density_at_zero
from hil.signals.deflection_noise import smallest_step
from hil.uncertainty.blocks import Blocks
from hil.uncertainty.confidence import covariance
from hil.uncertainty.model_average import without_positive

Array = NDArray[np.float64]

_FALLS_OVER = (0.25, 0.35, 0.5, 0.7, 1.0)  # of the rate of which damping is felt: over much less, a fall is no damping
_FALLING = ("Fs", "rise")  # parameters of a model that has it
_RISE = 0.5  # of friction at speed, by which it is higher at rest: a standard deviation
_SMALL = 0.1  # of the same: what is in proportion to it


def falling(largest: Largest, motion: Motion) -> list[tuple[Largest, float]]:
    """The fits with friction that falls over some rate, and Akaike's criterion of each less that without.

    [] where the model selected has no friction, or some that falls.
    """
    values = dict(zip(largest.names, largest.values.tolist(), strict=True))
    rubs = [name for name in values if _rubs(name)]
    if not set(rubs).difference(largest.added_names) or set(rubs) & set(_FALLING):
        return []
    found = []
    whole, rows = motion.whole
    seen = whole.delayed(values.get("skew", 0.0))
    friction = sum(values[name] * largest.columns[:, largest.names.index(name)] for name in rubs)
    for over in (part * felt(motion.dtheta_dot) for part in _FALLS_OVER):
        if "Fd" in values:
            more = seen.bristles(values["reach"], _SMALL, over) - seen.presliding(values["reach"])
            column = values["Fd"] / _SMALL * more[rows]
        else:
            column = friction * falls(seen.dtheta_dot, over)[rows]
        found += _fallen(largest, column)
    return found


def _fallen(largest: Largest, column: Array) -> list[tuple[Largest, float]]:
    """The fit with friction that falls, and Akaike's criterion of it; [] where it cannot be distinguished from others.

    [] too where the friction that is left at speed would be negative, and drive the joint.
    column (n,): the torque, N m, by which friction at rest is higher if that is as much as at speed.
    """
    columns = np.column_stack([largest.columns, column])
    try:
        values = least_absolute_deviations(columns, largest.target, np.append(largest.values, 0.0)).genes
    except RuntimeError:
        return []
    sampling = covariance(Blocks.of(columns, largest.target), values)
    if not sampling.distinct.all():
        return []
    fewer, matrix, criterion = without_positive(
        values, sampling.matrix, np.column_stack([largest.likely, [0.0, _RISE]])
    )
    if any(value < 0.0 for name, value in zip(largest.names, fewer, strict=True) if _rubs(name)):
        return []
    sampling = replace(sampling, matrix=matrix, quantile=sampling.quantile[:-1], distinct=sampling.distinct[:-1])
    known = np.stack([np.zeros(len(fewer)), np.full(len(fewer), np.inf)])  # used already
    fallen = replace(largest, values=fewer, sampling=sampling, likely=known)
    return [(fallen, criterion / _blurred(columns, values, largest.target) + 2.0 * math.log(len(_FALLS_OVER)))]


def _blurred(columns: Array, values: Array, target: Array) -> float:
    """The factor by which errors of the rate make the likelihood of a fit less certain.

    columns (n, p), values (p,), target (n,) N m: of the fit.
    """
    density = density_at_zero(target - columns @ values, 0.5 * smallest_step(target))
    return 1.0 + by_rate(len(target), density, float(np.mean(np.abs(target))))


def _rubs(name: str) -> bool:
    """Whether a name is of a parameter of friction; a nuisance parameter is none."""
    return name in PARAMETERS and PARAMETERS[name].friction
