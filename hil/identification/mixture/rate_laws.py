"""Build the largest model with friction that falls with the rate, and with damping that grows with the rate.

Friction can fall with the rate, as the friction of grease and of soft bristles does (Stribeck 1902; Canudas de Wit and
others 1995): it then subtracts from the torque what damping adds. Two quantities are unknown: the rate over which the
friction falls, and the size of the fall, which is at most the friction at speed. Models with a few of these rates are
added; together they have the weight of one model with one more parameter. If the recording hardly shows the fall, only
the limit above bounds its size.

No such model gets more weight than the selected one. Where the joint reverses, a rate that is a fraction of a sample
late, or friction that builds up, looks like a fall. If there is strong evidence for such a law although it was not
selected, the interval must contain both values.

In one joint of ten damping grows with the rate, as the damping of a moving fluid does. Noise can hide this, and Bc is
then the damping at the usual rate, not the damping of slow motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import parse
from ga.model.effects.friction import felt
from ga.model.effects.hysteresis import REACHES
from ga.model.memory import falls
from ga.model.terms import PARAMETERS, is_addable, of_kind, of_role, size_of
from ga.model.trajectory import Motion
from hil.identification.candidates.criterion import by_rate, density_at_zero
from hil.identification.candidates.late import Alternative
from hil.identification.mixture.largest import Largest, largest_model
from hil.signals.deflection_noise import smallest_step
from hil.signals.prepare import Signals
from hil.uncertainty.blocks import Blocks
from hil.uncertainty.confidence import Covariance, covariance
from hil.uncertainty.model_average import SELDOM, without_positive

Array = NDArray[np.float64]

_FALLS_OVER = (0.25, 0.35, 0.5, 0.7, 1.0)  # of the rate of which damping is felt: over much less, a fall is no damping
_RISE = 0.5  # of friction at speed, by which it is higher at rest: a standard deviation
_SMALL = 0.1  # of the same: what is in proportion to it
_GROWTH = 1.0  # of Bc, by which damping is higher at the rate of which it is felt: a standard deviation


def falling(largest: Largest, motion: Motion) -> list[tuple[Largest, float]]:
    """Return the fits with friction that falls over some rate, each with its change of Akaike's criterion.

    [] if the selected model has no friction, or already has friction that falls.
    """
    values = dict(zip(largest.names, largest.values.tolist(), strict=True))
    rubs = [name for name in values if name in PARAMETERS and PARAMETERS[name].friction]  # not those of nuisances
    if not set(rubs).difference(largest.added_names) or of_kind(rubs, "fall of friction"):
        return []
    found = []
    whole, rows = motion.whole
    seen, builds_up = whole.delayed(size_of(values, "delay")), of_kind(values, "presliding friction")
    friction = sum(values[name] * largest.columns[:, largest.names.index(name)] for name in rubs)
    # the fit is linearised, and may lie beyond the bounds
    reach = max(size_of(values, "presliding length"), REACHES[0] * float(np.ptp(motion.dtheta)))
    for over in (part * felt(motion.dtheta_dot) for part in _FALLS_OVER):
        if builds_up:
            more = seen.bristles(reach, _SMALL, over) - seen.presliding(reach)
            column = size_of(values, "presliding friction") / _SMALL * more[rows]
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
    """Return the fit with damping that grows with the rate, with its change of Akaike's criterion; [] if there is none.

    smaller: the model inside the largest one. doubtful: the terms that the data do not decide on. by_errors: a function
    that returns the correction of all parameters for errors of the deflection, because these errors look like such
    damping.
    """
    terms, usual = smaller.model.name.split("+"), felt(data.motion.dtheta_dot)
    (grows,) = of_role("damping")
    damping = float(largest.values[largest.names.index("Bc")])
    if not is_addable(grows, terms) or damping <= 0.0 or usual == 0.0:
        return []
    grown = largest_model(replace(smaller, model=parse("+".join((*terms, grows)))), doubtful, data)
    if grown is None:
        return []
    (growth,) = of_kind(grown.names, "growth of damping")
    grown = _with_last(replace(grown, values=grown.values + by_errors(grown)), growth)
    found = _marginal(grown, _GROWTH * damping / usual)
    return [(replace(one, model=largest.model), max(more + SELDOM, 0.0)) for one, more in found]


def _with_last(largest: Largest, name: str) -> Largest:
    """Return the same fit with the named parameter moved to the end."""
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
    """Return the fit with falling friction, with its change of Akaike's criterion; [] if it is not distinguishable.

    column (n,): the torque, N m, that friction adds near rest if friction at rest is twice the friction at speed.
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
    """Return the fit integrated over its last parameter, with its change of Akaike's criterion; [] if the parameters
    are not distinguishable.

    likely: the standard deviation of the last parameter before the data are seen, in its unit.
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
    """Return the factor by which errors of the rate reduce the information in the likelihood of a fit.

    columns (n, p): the columns of the fit. values (p,): its parameters. target (n,): the torque, N m.
    """
    density = density_at_zero(target - columns @ values, 0.5 * smallest_step(target))
    return 1.0 + by_rate(len(target), density, float(np.mean(np.abs(target))))
