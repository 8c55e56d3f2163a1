"""Kc and Bc averaged over the models that the data cannot decide between, so that the interval includes the choice.

Model selection leaves out what is not significant, but no bench is without offset, drift, friction and skew: the
interval given the selected model is too narrow. The average is over that model with and without those effects, and the
terms without strong evidence for or against them. Of these, one that a bench seldom has, a spring that curves, weighs
in the value as model selection judges it: noise often looks a little like a cubic spring, which moves Kc by far more
than its error. An offset and a skew are always there, the latter of a size that one recorder can produce, because the
two readings of one tick never have quite the same age. Dry friction never turns at once: what holds it is about as
stiff as the coupling, so that it builds up over some Fc/Kc (Dahl 1976), which stiffens small motion.

A spring that curves is selected with the curve that fits best, and no spring follows one of these curves exactly: the
stiffness at zero deflection depends on which.

Friction may fall with the rate, as that of grease and of soft bristles does (Stribeck 1902; Canudas de Wit and others
1995): it then takes from the torque what damping adds. Over which rate it falls is not known, nor by how much, up to as
much as it is at speed: models in which it does, over each of a few of the rates driven, weigh as one with a parameter
more. Where the recording hardly shows the fall, its size is limited by that alone.

A reading that is late is known by how it stiffens fast motion, and so does a viscoelastic branch that relaxes faster
than the joint moved. Any part of what looks late may be that, in one joint of ten, and is then not missing from Bc.

An angle that passed a filter which the torque did not looks like one that is read late, and exactly like an inertia: of
each model with an inertia in place of a skew, both readings are in the average.

In slow motion a late reading is less damping and shows in nothing else. Where none is selected, each likely time by
which it may be late stands beside the model, with its likelihood.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import CouplingModel, parse
from ga.model.friction import felt, slowest
from ga.model.memory import falls
from ga.model.separable import Problem
from ga.model.terms import CONSIDERED, PARAMETERS, TERMS, is_addable
from ga.model.trajectory import Motion
from hil.identification.fitting.deflection import read_with_errors
from hil.identification.fitting.jumps import rate_beside_jumps
from hil.identification.model_choice import Choice
from hil.identification.selection.late import Alternative
from hil.identification.selection.stepwise import Step
from hil.signals.prepare import Signals
from hil.uncertainty.blocks import Blocks
from hil.uncertainty.confidence import Covariance, covariance
from hil.uncertainty.criteria import COUPLING, EVIDENCE_AGAINST, TICK_SHARE, dampings_behind_filter
from hil.uncertainty.model_average import AKAIKE, average, without_positive

Array = NDArray[np.float64]

_ALWAYS = ("offset", "skew")
_NORMAL = 1.96  # half a 95 % interval in standard errors
_PRESLIDING = "presliding"  # a nuisance parameter, 1 where friction builds up over Fc/Kc
_FALLS_OVER = (0.25, 0.35, 0.5, 0.7, 1.0)  # of the rate of which damping is felt: over much less, a fall is no damping
_FALLING = ("Fs", "rise")  # parameters of a model that has it
_RISE = 0.5  # of friction at speed, by which it is higher at rest: a standard deviation
_SMALL = 0.1  # of the same: what is in proportion to it
_RELAXING = (1.0 / 11.0 / 3.0) ** 0.5  # one joint in ten: any part of what looks late, a standard deviation
_PLACES = 2**44  # steps of a range, to one of which a quantile is found
_SEEN, _FEWEST = 0.1, 100  # part of the friction, and samples, from which its building up is seen
_BENCH = (*_ALWAYS, "drift", "coulomb")  # effects that every bench has
_CURVES = ("cubic", "quintic", "progressive")  # a spring that curves has no more reason to follow one of them


@dataclass(frozen=True, slots=True)
class Averaged:
    """An estimate averaged over models, SI: its value and half its 95 % interval, given the noise and the choice."""

    value: float
    half_width: float


def averaged(
    choice: Choice, signals: Signals, used: NDArray[np.bool_], nonlinear: Array, change: Mapping[str, float]
) -> dict[str, Averaged]:
    """Return Kc and Bc averaged over models around the selected one; {} where the larger ones cannot be fitted.

    used (n,): the samples that it is fitted to. nonlinear (q,): its nonlinear parameters. change: by which errors of
    the deflection are taken off its parameters, SI, by name; of a larger model other changes are.
    """
    if not (choice.steps and isinstance(choice.model, CouplingModel)):
        return {}
    kept = replace(signals, motion=signals.motion.of(used), torque=signals.torque[used], jerked=None)
    doubtful = {
        step.term: AKAIKE if step.term in _BENCH else step.cost
        for step in choice.steps
        if step.term in CONSIDERED and _is_doubtful(step)
    }
    selected = Alternative(choice.model, nonlinear, 0.0)
    own = dict(zip((one.name for one in choice.model.nonlinear), nonlinear.tolist(), strict=True))
    seems_filtered = own.get("skew", 0.0) < 0.0 and signals.torque_from == "given"
    found, criteria = [], []

    def of_selected(larger: _Largest) -> Array:
        return np.array([change.get(name, 0.0) for name in larger.names])

    def of_larger(larger: _Largest) -> Array:
        return _by_errors(larger, signals, used)

    for one in (selected, *choice.alternatives):
        # an alternative may be far off, and with it what errors would do to its parameters
        is_own = one is selected and any(change.values())
        around = _around(one, doubtful, kept, of_larger if is_own else of_selected)
        if not around and one is selected:
            return {}
        if one is not selected and seems_filtered:
            around += _behind_filter(one, around, kept)
        found += [values for values, _ in around]
        criteria += [one.criterion + more for _, more in around]
    for late in choice.lateness:
        stiff, damped = (found[0][name].half_width for name in COUPLING)
        damped = float(np.hypot(damped, _NORMAL * late.spread))
        found.append({"Kc": Averaged(late.Kc + change["Kc"], stiff), "Bc": Averaged(late.Bc + change["Bc"], damped)})
        criteria.append(late.criterion)
    weights = np.exp(-0.5 * (np.array(criteria) - min(criteria)))
    weights /= weights.sum()
    mixed = {name: _mixed(weights, [one[name] for one in found]) for name in COUPLING}
    hidden = mixed["Kc"].value * _late(choice.model, nonlinear)
    bc = mixed["Bc"]
    return mixed | {"Bc": Averaged(bc.value, float(np.hypot(bc.half_width, _NORMAL * _RELAXING * hidden)))}


def _behind_filter(
    one: Alternative, around: Sequence[tuple[dict[str, Averaged], float]], data: Signals
) -> list[tuple[dict[str, Averaged], float]]:
    """The estimates of a model with an inertia, read as those of a joint whose angle passed a filter; [] without one.

    The torque of both is the same (`damping_behind_filter`), so that neither is likelier. Of two filters the faster one
    is meant: a slow one would be known.
    """
    inertia = _own_values(one, data).get("J", 0.0) if "inertia" in one.model.name.split("+") else 0.0
    found = []
    for mean, criterion in around:
        stiff, damped = mean["Kc"], mean["Bc"]
        behind = dampings_behind_filter(stiff.value, damped.value, inertia)
        if not behind:
            continue
        # by how much it changes with the damping that is seen, and it is no more than that
        gain = behind[-1] / max(behind[-1] - behind[0], 1e-300)
        half_width = min(gain * damped.half_width, damped.half_width + damped.value)
        found.append((mean | {"Bc": Averaged(behind[-1], half_width)}, criterion))
    return found


def _late(model: CouplingModel, nonlinear: Array) -> float:
    """By how much, s, the torque reading is late in a model with nonlinear parameters (q,)."""
    names = [parameter.name for parameter in model.nonlinear]
    return float(sum(abs(nonlinear[names.index(name)]) for name in ("skew", "lag") if name in names))


def _mixed(weights: Array, found: Sequence[Averaged]) -> Averaged:
    """The median of a mixture of normal estimates with weights (m,) of sum one, and how far its middle 95 % reaches.

    Its standard deviation would not do: a model that is as likely as one in ten, and far away, is as far outside. Its
    mean, and the middle of that interval, would follow such a model where nothing speaks for it.
    """
    values, errors = (np.array(of) for of in zip(*((one.value, one.half_width) for one in found), strict=True))
    low, high = float(np.min(values - 2.0 * errors)), float(np.max(values + 2.0 * errors))
    step = (high - low) / _PLACES  # scipy.optimize would take a tenth of a run to import

    def beyond(share: float) -> float:
        def below(place: int) -> float:
            return float(weights @ ndtr(_NORMAL * (low + place * step - values) / errors))

        return low + step * bisect_left(range(_PLACES), share, key=below)

    least, value, most = beyond(0.025), beyond(0.5), beyond(0.975)
    return Averaged(value, max(most - value, value - least))


def _by_errors(larger: _Largest, signals: Signals, used: NDArray[np.bool_]) -> Array:
    """The change (p,) by which errors of the deflection are taken off the parameters of the larger model."""
    found, count = np.zeros(len(larger.values)), len(larger.model.parameters)
    sampling = larger.sampling
    half_width = (sampling.quantile * np.sqrt(np.maximum(np.diag(sampling.matrix), 0.0)))[:count]
    errors = read_with_errors(larger.model, signals, used, larger.values[:count], half_width)
    if errors is not None:
        found[:count] = errors.change
    return found


def _around(
    model: Alternative, doubtful: Mapping[str, float], data: Signals, by_errors: Callable[[_Largest], Array]
) -> list[tuple[dict[str, Averaged], float]]:
    """Kc and Bc averaged over one model with and without the effects that every bench has; [] where none can be.

    Then those of models with friction that falls, each with Akaike's criterion less that of the first. doubtful: the
    terms that the data do not decide on, and the cost of each. by_errors: the change of all parameters by which errors
    of the deflection are taken off them.
    """
    largest = _largest(model, tuple(doubtful), data)
    if largest is None or not _contains(largest, model, data):
        return []
    found = [(largest, 0.0), *_falling(largest, data.motion)]
    change = by_errors(largest)
    means = [(_mean(replace(one, values=one.values + change), doubtful), criterion) for one, criterion in found]
    return [one for one in means if one[0]] if means[0][0] else []


def _mean(largest: _Largest, doubtful: Mapping[str, float]) -> dict[str, Averaged]:
    """Kc and Bc averaged over all models in the largest; {} where none is possible."""
    names, sampling = largest.names, largest.sampling
    costs = {name: cost for term, cost in _costs(largest.added, doubtful).items() for name in _own(term)}
    found = average(
        largest.values,
        sampling.matrix,
        {at: costs[name] for at, name in enumerate(names) if name in costs},
        # the model's own terms were found possible without what is added: a skew beside an inertia takes it over
        [at for at, name in enumerate(names) if name in costs and PARAMETERS[name].positive],
        largest.likely,
        bounded=[names.index(name) for name in COUPLING],
    )
    if found is None:
        return {}
    return {
        name: Averaged(float(found.values[at]), float(sampling.quantile[at] * found.errors[at]))
        for at, name in enumerate(names)
        if name in COUPLING
    }


def _costs(added: Sequence[str], doubtful: Mapping[str, float]) -> dict[str, float]:
    """The cost of each term that a model may do without: those added, and those that the data do not decide on.

    Where they do not decide whether the spring curves at all, no other curve is likelier than the one in doubt.
    """
    curving = max((cost for term, cost in doubtful.items() if term in _CURVES), default=AKAIKE)
    found = {term: curving if term in _CURVES else AKAIKE for term in added if term not in _ALWAYS}
    return found | dict(doubtful)


@dataclass(frozen=True, eq=False)
class _Largest:
    """The fit of the model that contains all others: values (p,) of the parameters `names`, and the terms added.

    The names are those of the model's parameters, and the one of friction that builds up, where it is added.

    columns (n, p) and target (n,), N m: of the linear problem around it. likely (2, p): as of `average`.
    """

    model: CouplingModel
    added: tuple[str, ...]
    names: list[str]
    columns: Array
    target: Array
    values: Array
    sampling: Covariance
    likely: Array


def _largest(smaller: Alternative, doubtful: Sequence[str], data: Signals) -> _Largest | None:
    """The largest model in which each added term can be distinguished from the others; None where there is none.

    It is linearised at the fit of the smaller one: what is added is small, and would wander off together with a lag.
    """
    chosen = smaller.model.name.split("+")
    added: list[str] = []
    curves = _CURVES if {*_CURVES, "asymmetric"}.intersection(chosen) else ()
    hidden = {"coulomb"} if slowest(data.motion) == 0.0 else set()  # its sign would be that of the rate's noise
    # a short lag differs from a skew by less than what estimates both at once
    hidden |= {"skew"} if "lag" in chosen else set()
    for term in (*_BENCH, *doubtful, *curves):
        added += [term] if is_addable(term, (*chosen, *added)) and term not in hidden else []
    start = {parameter.name: parameter.absent for parameter in PARAMETERS.values()}
    start |= dict(zip((one.name for one in smaller.model.nonlinear), smaller.nonlinear.tolist(), strict=True))
    while True:
        larger = parse("+".join((*chosen, *added))).anchored(data.motion)
        problem = Problem(larger, data.motion, data.torque, *larger.bounds(data.motion, data.band[1]))
        try:
            fit = problem.solve(np.array([start[p.name] for p in larger.nonlinear], dtype=np.float64))
            names = [parameter.name for parameter in larger.parameters]
            columns, target = problem.linearised(fit)
            if (building := _building_up(dict(zip(names, fit.values, strict=True)), data.motion)) is not None:
                names, columns = [*names, _PRESLIDING], np.column_stack([columns, building])
            first = np.append(fit.values, np.zeros(len(names) - len(fit.values)))
            values = least_absolute_deviations(columns, target, first).genes
        except RuntimeError:  # some columns are dependent
            return None
        sampling = covariance(Blocks.of(columns, target), values)
        alike = [term for term in added if not all(sampling.distinct[names.index(name)] for name in _own(term))]
        if not alike:
            likely = _likely(added, names, data.motion)
            sampling = _with_jumps(sampling, columns, float(values[names.index("Bc")]), data)
            return _Largest(larger, tuple(added), names, columns, target, values, sampling, likely)
        added.remove(alike[-1])


def _with_jumps(sampling: Covariance, columns: Array, damping: float, data: Signals) -> Covariance:
    """The covariance with what rates beside jumps of the acceleration do to the parameters of columns (n, p)."""
    missing = rate_beside_jumps(data.motion, data.command)
    if missing is None:
        return sampling
    moved = np.linalg.lstsq(columns, damping * missing, rcond=None)[0]
    return replace(sampling, matrix=sampling.matrix + np.outer(moved, moved))


def _likely(added: Sequence[str], names: Sequence[str], motion: Motion) -> Array:
    """What each parameter is likely to be, and a standard deviation of that, (2, p)."""
    likely = np.stack([np.zeros(len(names)), np.full(len(names), np.inf)])
    if "skew" in added:
        likely[1, names.index("skew")] = TICK_SHARE * float(np.median(np.diff(motion.time)))
    if _PRESLIDING in names:
        likely[:, names.index(_PRESLIDING)] = 1.0
    return likely


def _falling(largest: _Largest, motion: Motion) -> list[tuple[_Largest, float]]:
    """The fits with friction that falls over some rate, and Akaike's criterion of each less that without.

    [] where the model selected has no friction, or some that falls.
    """
    values = dict(zip(largest.names, largest.values.tolist(), strict=True))
    rubs = [name for name in values if _rubs(name)]
    if not set(rubs).difference(_own("coulomb") if "coulomb" in largest.added else ()) or set(rubs) & set(_FALLING):
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


def _fallen(largest: _Largest, column: Array) -> list[tuple[_Largest, float]]:
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
    return [
        (replace(largest, values=fewer, sampling=sampling, likely=known), criterion + 2.0 * math.log(len(_FALLS_OVER)))
    ]


def _building_up(values: Mapping[str, float], motion: Motion) -> Array | None:
    """The torque (n,), N m, by which friction that builds up over Fc/Kc differs from one that turns at once.

    None where the model, whose values are given by name, has no Coulomb friction, or that is too short to be seen.
    """
    friction, stiffness = values.get("Fc", 0.0), values["Kc"]
    if friction <= 0.0 or stiffness <= 0.0:
        return None
    whole, rows = motion.whole
    seen = whole.delayed(values.get("skew", 0.0))
    found = friction * (seen.presliding(friction / stiffness) - np.sign(seen.dtheta_dot))[rows]
    return found if np.count_nonzero(np.abs(found) > _SEEN * friction) >= _FEWEST else None


def _contains(largest: _Largest, smaller: Alternative, data: Signals) -> bool:
    """Return whether the larger fit, with what was added set to zero, is the smaller fit, within its interval.

    Both are of the same data. Where they differ, the error of the larger one does not say how its parameters move
    together (residuals that last longer than what is averaged over), and an average would lead away from both.
    """
    own = _own_values(smaller, data)
    names, matrix = largest.names, largest.sampling.matrix
    extra = [name for term in largest.added for name in _own(term)]
    added = [names.index(name) for name in (*extra, _PRESLIDING) if name in names]
    if not added:
        return True
    gain = np.linalg.lstsq(matrix[np.ix_(added, added)], matrix[added], rcond=None)[0]  # (added, p)
    restricted = largest.values - largest.values[added] @ gain
    variance = matrix.diagonal() - np.einsum("ap,ap->p", matrix[added], gain)
    with np.errstate(invalid="ignore"):  # one that is not distinct has no reach, as beside a factor of zero
        reach = largest.sampling.quantile * np.sqrt(np.maximum(variance, 0.0))
    return all(abs(restricted[names.index(name)] - own[name]) <= reach[names.index(name)] for name in COUPLING)


def _own_values(one: Alternative, data: Signals) -> dict[str, float]:
    """The linear parameters of a model, SI, by name, at its nonlinear ones."""
    columns = one.model.columns(data.motion, one.nonlinear)
    target = one.model.target(data.motion, data.torque, one.nonlinear)
    values = least_absolute_deviations(columns, target).genes.tolist()
    return dict(zip((parameter.name for parameter in one.model.linear), values, strict=True))


def _is_doubtful(step: Step) -> bool:
    """Whether the evidence for or against the term of a step is not strong."""
    term = TERMS[step.term]
    return term.linear and term.selection != "smallest" and abs(step.gain) < -EVIDENCE_AGAINST


def _rubs(name: str) -> bool:
    """Whether a name is of a parameter of friction; a nuisance parameter is none."""
    return name in PARAMETERS and PARAMETERS[name].friction


def _own(term: str) -> tuple[str, ...]:
    return tuple(parameter.name for parameter in TERMS[term].parameters)
