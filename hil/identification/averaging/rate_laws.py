"""The fits of the largest model with friction that falls with the rate, and with damping that grows with it.

Friction may fall with the rate, as that of grease and of soft bristles does (Stribeck 1902; Canudas de Wit and others
1995): it then takes from the torque what damping adds. Over which rate it falls is not known, nor by how much, up to as
much as it is at speed: models in which it does, over each of a few of the rates driven, weigh as one with a parameter
more. Where the recording hardly shows the fall, its size is limited by that alone.

None weighs more than the model selected. Where the joint turns, a rate that is a part of a sample late, or friction
that builds up, looks like a fall. If such a law has strong evidence and was not selected, both values belong in the
interval.

Damping may grow with the rate, as that of a fluid in motion does, in one joint of ten. In much noise nothing shows it,
and Bc is then that of the usual rate, not that of slow motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import parse
from ga.model.friction import felt
from ga.model.hysteresis import REACHES
from ga.model.memory import falls
from ga.model.terms import PARAMETERS, is_addable
from ga.model.trajectory import Motion
from hil.identification.averaging.largest import Largest, largest_model
from hil.identification.selection.criterion import by_rate, density_at_zero
from hil.identification.selection.late import Alternative
from hil.signals.deflection_noise import smallest_step
from hil.signals.prepare import Signals
from hil.uncertainty.blocks import Blocks
from hil.uncertainty.confidence import Covariance, covariance
from hil.uncertainty.model_average import SELDOM, without_positive

Array = NDArray[np.float64]

_FALLS_OVER = (0.25, 0.35, 0.5, 0.7, 1.0)  # of the rate of which damping is felt: over much less, a fall is no damping
_FALLING = ("Fs", "rise")  # parameters of a model that has it
_RISE = 0.5  # of friction at speed, by which it is higher at rest: a standard deviation
_SMALL = 0.1  # of the same: what is in proportion to it
_GROWTH = 1.0  # of Bc, by which damping is higher at the rate of which it is felt: a standard deviation


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
    # the fit is linearised, and may lie beyond the bounds
    reach = max(values.get("reach", 0.0), REACHES[0] * float(np.ptp(motion.dtheta)))
    for over in (part * felt(motion.dtheta_dot) for part in _FALLS_OVER):
        if "Fd" in values:
            more = seen.bristles(reach, _SMALL, over) - seen.presliding(reach)
            column = values["Fd"] / _SMALL * more[rows]
        else:
            column = friction * falls(seen.dtheta_dot, over)[rows]
        found += [(one, max(more, 0.0) + 2.0 * math.log(len(_FALLS_OVER))) for one, more in _fallen(largest, column)]
    # friction that is left at speed would drive the joint where it is negative
    return [(one, more) for one, more in found if all(one.values[one.names.index(name)] >= 0.0 for name in rubs)]


def growing(
    largest: Largest,
    smaller: Alternative,
    doubtful: Sequence[str],
    data: Signals,
    by_errors: Callable[[Largest], Array],
) -> list[tuple[Largest, float]]:
    """The fit with damping that grows with the rate, and Akaike's criterion of it less that without; [] without one.

    smaller, doubtful: the model in the largest one, and terms that the data do not decide on. by_errors: the change by
    which errors of the deflection are taken off all parameters. They look like such damping themselves.
    """
    terms, usual = smaller.model.name.split("+"), felt(data.motion.dtheta_dot)
    damping = float(largest.values[largest.names.index("Bc")])
    if not is_addable("quadratic", terms) or damping <= 0.0 or usual == 0.0:
        return []
    grown = largest_model(replace(smaller, model=parse("+".join((*terms, "quadratic")))), doubtful, data)
    if grown is None:
        return []
    grown = _with_last(replace(grown, values=grown.values + by_errors(grown)), "B2")
    found = _marginal(grown, _GROWTH * damping / usual)
    return [(replace(one, model=largest.model), max(more + SELDOM, 0.0)) for one, more in found]


def _with_last(largest: Largest, name: str) -> Largest:
    """The same fit with a parameter as its last."""
    order = sorted(range(len(largest.names)), key=lambda at: largest.names[at] == name)
    known = largest.sampling
    sampling = Covariance(
        known.matrix[np.ix_(order, order)], known.quantile[order], known.distinct[order], known.inflation[order]
    )
    return replace(
        largest,
        names=[largest.names[at] for at in order],
        columns=largest.columns[:, order],
        values=largest.values[order],
        sampling=sampling,
        likely=largest.likely[:, order],
    )


def _fallen(largest: Largest, column: Array) -> list[tuple[Largest, float]]:
    """The fit with friction that falls, and Akaike's criterion of it; [] where it cannot be distinguished from others.

    column (n,): the torque, N m, by which friction at rest is higher if that is as much as at speed.
    """
    columns = np.column_stack([largest.columns, column])
    try:
        values = least_absolute_deviations(columns, largest.target, np.append(largest.values, 0.0)).genes
    except RuntimeError:
        return []
    sampling = covariance(Blocks.of(columns, largest.target), values)
    likely = np.column_stack([largest.likely, [0.0, np.inf]])
    names = [*largest.names, "fall"]
    fallen = replace(largest, names=names, columns=columns, values=values, sampling=sampling, likely=likely)
    return _marginal(fallen, _RISE)


def _marginal(larger: Largest, likely: float) -> list[tuple[Largest, float]]:
    """The fit, whatever its last parameter is, and Akaike's criterion of it less that without; [] if not distinct.

    likely: a standard deviation of that parameter, in its unit.
    """
    sampling = larger.sampling
    if not (sampling.distinct & (np.diag(sampling.matrix) > 0.0)).all():
        return []
    penalty = larger.likely.copy()
    penalty[1, -1] = likely
    fewer, matrix, criterion = without_positive(larger.values, sampling.matrix, penalty)
    known = np.stack([np.zeros(len(fewer)), np.full(len(fewer), np.inf)])  # used already
    found = replace(
        larger,
        names=larger.names[:-1],
        columns=larger.columns[:, :-1],
        values=fewer,
        sampling=replace(sampling, matrix=matrix, quantile=sampling.quantile[:-1], distinct=sampling.distinct[:-1]),
        likely=known,
    )
    return [(found, criterion / _blurred(larger.columns, larger.values, larger.target))]


def _blurred(columns: Array, values: Array, target: Array) -> float:
    """The factor by which errors of the rate make the likelihood of a fit less certain.

    columns (n, p), values (p,), target (n,) N m: of the fit.
    """
    density = density_at_zero(target - columns @ values, 0.5 * smallest_step(target))
    return 1.0 + by_rate(len(target), density, float(np.mean(np.abs(target))))


def _rubs(name: str) -> bool:
    """Whether a name is of a parameter of friction; a nuisance parameter is none."""
    return name in PARAMETERS and PARAMETERS[name].friction
