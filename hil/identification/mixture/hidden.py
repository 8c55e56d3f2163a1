"""What a recording may hide: effects that nearly follow the columns of the largest model, and change Kc or Bc.

Each is one column, with the size that joints or drives have of it, and the odds against it:

- Friction falls with the rate, as that of grease and of soft bristles does (Stribeck 1902; Canudas de Wit and others
  1995): it then subtracts from the torque what damping adds. Two quantities are unknown, the rate over which it falls,
  and by how much, which is at most the friction at speed.
- Damping grows with the rate, as that of a moving fluid does. Bc is then the damping at the usual rate, and not that of
  slow motion.
- A branch relaxes faster than the joint moves: it looks like a torque that is read late, or like damping. Beside a
  branch, another one relaxes slowly.
- The spring curves, softens or has a narrow gap, or friction in proportion to the torque builds up: each a small part
  of the spring's torque, below what selection finds.
- A drive holds its set-points between two readings, and the true rate is lower than that of the smooth motion.

The fit with such a column is integrated over its size, and has the weight that its odds and its likelihood give it; but
none is likelier than the likeliest model without. Where the joint reverses, a rate that is a fraction of a sample late
looks like much of this. What an error of the rate explains is therefore no evidence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from ga.arrays import Array
from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import parse
from ga.model.effects.friction import rate_of_damping
from ga.model.effects.hysteresis import REACHES
from ga.model.effects.springs import SHORTEST_RELAXATION
from ga.model.memory import falls
from ga.model.terms import PARAMETERS, TERMS, is_addable, of_kind, of_role, size_of
from hil.identification.candidates.criterion import by_rate, density_at_zero
from hil.identification.deflection.held import damping_at, taken_off
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import covariance
from hil.identification.mixture.largest import Largest, Selected
from hil.identification.mixture.model_average import without_positive
from hil.signals import constants as c
from hil.signals.deflection_noise import smallest_step


class Hidden(NamedTuple):
    """An effect of which a joint or a drive may have a little.

    column (n,): its torque, N m, for a factor of one. size: the standard deviation of the factor, which is positive.
    against: twice the log odds against all effects of its kind, of which there are `among`.
    """

    column: Array
    size: float
    against: float = 0.0
    among: int = 1


def hidden(largest: Largest, selected: Selected) -> Iterator[tuple[Largest, Hidden]]:
    """Yield each hidden effect with the fit of the largest model beside it, its factor the last parameter."""
    effects = (yielding(largest, selected) for yielding in (_falling, _growing, _relaxing, _held, _uneven))
    for effect in chain.from_iterable(effects):
        columns = np.column_stack([largest.columns, effect.column])
        try:
            values = least_absolute_deviations(columns, largest.target, np.append(largest.values, 0.0)).genes
        except RuntimeError:  # it is dependent on the others
            continue
        sampling = covariance(Blocks.of(columns, largest.target), values)
        if (sampling.distinct & (np.diag(sampling.matrix) > 0.0)).all():
            names = [*largest.names, ""]
            yield replace(largest, names=names, columns=columns, values=values, sampling=sampling), effect


def integrated(larger: Largest, size: float, prior: Array) -> tuple[Largest, float]:
    """Return the fit integrated over its last parameter, and twice the log odds against that parameter.

    size: the standard deviation of that parameter before the data are seen. prior (2, p): those of the others.
    """
    sampling = larger.sampling
    penalty = np.column_stack([prior, [0.0, size]])
    fewer, matrix, criterion = without_positive(larger.values, sampling.matrix, penalty)
    known = np.stack([np.zeros(len(fewer)), np.full(len(fewer), np.inf)])  # used already
    found = replace(
        larger,
        names=larger.names[:-1],
        columns=larger.columns[:, :-1],
        values=fewer,
        sampling=replace(sampling, matrix=matrix, quantile=sampling.quantile[:-1], distinct=sampling.distinct[:-1]),
        prior=known,
    )
    return found, criterion / _blurred(larger)


def _falling(largest: Largest, selected: Selected) -> Iterator[Hidden]:
    """Yield friction that falls over each of a few rates, if the selected model has friction that does not fall."""
    values = dict(zip(largest.names, largest.values.tolist(), strict=True))
    rubs = [name for name in values if name in PARAMETERS and PARAMETERS[name].friction]  # not those of nuisances
    if not set(rubs).difference(largest.added_names) or of_kind(rubs, "fall of friction"):
        return
    motion = selected.data.motion
    whole, rows = motion.whole
    seen, builds_up = whole.delayed(size_of(values, "delay")), of_kind(values, "presliding friction")
    friction = sum(values[name] * largest.columns[:, largest.names.index(name)] for name in rubs)
    # the fit is linearised, and may lie beyond the bounds
    reach = max(size_of(values, "presliding length"), REACHES[0] * float(np.ptp(motion.dtheta)))
    for over in (part * rate_of_damping(motion.dtheta_dot) for part in c.FALLS_OVER):
        column = friction * falls(seen.dtheta_dot, over)[rows]
        if builds_up:
            more = seen.bristles(reach, c.RISE, over) - seen.presliding(reach)
            column = size_of(values, "presliding friction") / c.RISE * more[rows]
        yield Hidden(column, c.RISE, among=len(c.FALLS_OVER))


def _growing(largest: Largest, selected: Selected) -> Iterator[Hidden]:
    """Yield damping that grows with the rate, if the model has none."""
    (grows,) = of_role("damping")
    usual, damping = rate_of_damping(selected.data.motion.dtheta_dot), float(largest.values[largest.names.index("Bc")])
    if is_addable(grows, selected.model.name.split("+")) and damping > 0.0 and usual > 0.0:
        yield Hidden(_column(grows, selected, {}), c.GROWTH * damping / usual, c.ONE_IN_TEN)


def _relaxing(largest: Largest, selected: Selected) -> Iterator[Hidden]:
    """Yield a branch of each of a few relaxation times, up to the shortest period of the motion, if the model has a
    skew: in one of ten joints with a skew, such a branch causes it. If the model has a branch, yield slower ones too.
    """
    terms, values = selected.model.name.split("+"), dict(zip(largest.names, largest.values.tolist(), strict=True))
    branch = next((term for term in of_role("branch") if is_addable(term, terms)), "")
    if not branch or values["Kc"] <= 0.0:
        return
    (name,) = (one.name for one in TERMS[branch].parameters if one.nonlinear)
    if any(TERMS[term].delays for term in terms):
        for time in np.geomspace(SHORTEST_RELAXATION, 1.0, c.RELAXES) / selected.data.band[1]:
            column = _column(branch, selected, {name: float(time)})
            yield Hidden(column, c.STIFFEST * values["Kc"], 2.0 * c.ONE_IN_TEN, c.RELAXES)
    slowest = c.SLOWEST_BRANCH * float(np.ptp(selected.data.motion.time))
    if (relaxing := size_of(values, "relaxing stiffness")) > 0.0 and slowest * selected.data.band[1] > 1.0:
        for time in np.geomspace(1.0 / selected.data.band[1], slowest, c.BRANCHES):
            yield Hidden(_column(branch, selected, {name: float(time)}), relaxing, c.ONE_IN_TEN, c.BRANCHES)


def _held(largest: Largest, selected: Selected) -> Iterator[Hidden]:
    """Yield what a drive that holds its set-points takes off the torque."""
    values = dict(zip(largest.names, largest.values.tolist(), strict=True))
    motion = selected.data.motion
    if not of_kind(values, "moment of inertia") and values["Bc"] > 0.0:
        acts = np.abs(largest.columns[:, largest.names.index("Bc")]) > 0.5 * np.abs(motion.dtheta_dot)  # not in a gap
        yield Hidden(-damping_at(motion.dtheta_dot, values) * taken_off(motion) * acts, 1.0, c.ONE_IN_TEN)


def _uneven(largest: Largest, selected: Selected) -> Iterator[Hidden]:
    """Yield what makes the spring uneven, if the model has no such term: a curve, a stiffness that drifts, a narrow
    gap, and friction in proportion to the torque that builds up.
    """
    terms, largest_terms = selected.model.name.split("+"), largest.model.name.split("+")
    motion, roles = selected.data.motion, {TERMS[term].role for term in terms}
    index = {name: largest.names.index(name) for name in c.COUPLING}
    spring = largest.values[index["Kc"]] * largest.columns[:, index["Kc"]]
    if roles.intersection({"curve", "play", "load"}) or not largest.values[index["Kc"]] > 0.0:
        return
    torques = [
        _column(term, selected, {})
        for term in of_role("curve", "change")
        if TERMS[term].linear and is_addable(term, largest_terms)
    ]
    carried = np.abs(spring + largest.values[index["Bc"]] * largest.columns[:, index["Bc"]])
    whole, rows = motion.whole
    reach = c.BUILDS_UP * float(np.ptp(motion.dtheta))
    torques += [-np.sign(motion.dtheta), carried * whole.presliding(reach)[rows]]
    for torque in torques:
        power = float(np.mean(torque**2))
        if power > 0.0:
            yield Hidden(torque, c.UNEVEN * (float(np.mean(spring**2)) / power) ** 0.5, c.ONE_IN_TEN, len(torques))


def _column(term: str, selected: Selected, nonlinear: dict[str, float]) -> Array:
    """Return the column (n,) of a linear parameter of a term beside the selected model's. nonlinear: its others, SI."""
    motion, model = selected.data.motion, parse(f"{selected.model.name}+{term}").anchored(selected.data.motion)
    given = dict(zip((one.name for one in selected.model.nonlinear), selected.nonlinear.tolist(), strict=True))
    given |= nonlinear
    columns = model.columns(motion, np.array([given[one.name] for one in model.nonlinear], dtype=np.float64))
    (at,) = (at for at, one in enumerate(model.linear) if one in TERMS[term].parameters)
    return np.asarray(columns[:, at])


def _blurred(largest: Largest) -> float:
    """Return the factor by which errors of the rate reduce the information in the likelihood of a fit."""
    density = density_at_zero(largest.target - largest.columns @ largest.values, 0.5 * smallest_step(largest.target))
    return 1.0 + by_rate(len(largest.target), density, float(np.mean(np.abs(largest.target))))
