"""What may be believed of a result: the interval of each parameter, whether the recording can tell it, and why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ga.trials.trials import Trials
from hil.diagnostics import Diagnostic
from hil.identification.model_choice import Coupling
from hil.identification.result import Estimate, Repeatability, Validation
from hil.identification.stepwise import Rung
from hil.signals.prepare import Signals
from hil.uncertainty.confidence import ConfidenceIntervals
from hil.uncertainty.stationarity import VarianceComponents

Array = NDArray[np.float64]

_CONFUSED = 300.0  # variance inflation from which a parameter is another's as much as its own
TOLD = 0.35  # half the width of its interval, as a part of its value, up to which Kc or Bc is told
_OPTIMISER_GAP = 1e-3  # relative gap from which the search is said not to have arrived
_MARGIN = 1e-4  # part of a range within which a value is at its end
_STRONGLY_AGAINST = -6.0  # of a gain: evidence against a term that is strong (Kass and Raftery 1995)
_UNEXPLAINED = 0.9  # of the torque's spread, left in held-out blocks, from which a model explains nothing
_APART = 3.0  # times the recordings' own errors, from which what lies between them is what makes an interval wide
_LIKE_FRICTION = 0.95  # square of the cosine between a rate and its sign, from which damping is friction as well
_ONE_SPEED = 0.79  # the same, from which it may be: a triangle has 1, a sine 0.81, two sines less, a chirp 0.6
_COUPLING = ("Kc", "Bc")
_PRESENT = ("Fc", "K3", "J", "gap")
"""What is there or not: told where its interval does not hold zero."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What there is to judge. columns: (m, p + q), of the signals. values, low, high: (p + q,), SI, of all parameters.

    scattered: of pooled recordings, what lies within and between.
    gap: of the search, relative. unmoved: what is said of a recording in which nothing moved, "" otherwise.
    """

    model: Coupling
    signals: Signals
    columns: Array
    values: Array
    errors: ConfidenceIntervals
    scattered: tuple[VarianceComponents | None, ...]
    trials: Trials
    low: Array
    high: Array
    gap: float
    holdout: Validation
    unmoved: str = ""

    @property
    def names(self) -> list[str]:
        """All parameters' names."""
        return [parameter.name for parameter in (*self.model.linear, *self.model.shape)]

    def told(self, at: int) -> bool:
        """Whether the recording can tell the parameter at that place."""
        half = float(self.errors.half_width[at])
        told = np.isfinite(half) and self.errors.inflation[at] < _CONFUSED
        if self.names[at] == "Bc":  # friction that the model leaves out would be in it, whatever the interval
            told = told and self.friction_alike < _LIKE_FRICTION
        if self.names[at] in _COUPLING:  # a coupling is known once its value stands out from its interval
            told = told and half < TOLD * abs(self.values[at]) and not self.unmoved
        if self.names[at] in _PRESENT:
            told = told and half < abs(self.values[at])
        return bool(told)

    @property
    def friction_alike(self) -> float:
        """How much of a damping dry friction would pass for, 0 to 1, where the model has no term for it.

        The square of the cosine between the rate and its sign. 0 for a user's own model, which may have one by any
        name.
        """
        power = float(np.mean(self.signals.motion.dtheta_dot**2))
        if "Fc" in self.names or not self.model.linear or power == 0.0:
            return 0.0
        return float(np.mean(np.abs(self.signals.motion.dtheta_dot))) ** 2 / power

    def at_bound(self, at: int) -> str | None:
        """Which end of its bounds the exact optimum lies at or beyond, None for neither."""
        near = min(_MARGIN * (self.high[at] - self.low[at]), float(self.errors.half_width[at]))
        if self.values[at] <= self.low[at] + near:
            return "low"
        return "high" if self.values[at] >= self.high[at] - near else None


def estimates(evidence: Evidence) -> tuple[Estimate, ...]:
    """All parameters, in the model's order."""
    found = []
    for at, parameter in enumerate((*evidence.model.linear, *evidence.model.shape)):
        value, half = float(evidence.values[at]), float(evidence.errors.half_width[at])
        best, mean, std = (float(of[at]) for of in (evidence.trials.best, evidence.trials.mean, evidence.trials.std))
        found.append(
            Estimate(
                name=parameter.name,
                unit=parameter.unit,
                value=value,
                ci95=(value - half, value + half),
                optimiser=Repeatability(best, mean, std),
                identifiable=evidence.told(at),
                at_bound=evidence.at_bound(at),
                bounds=(float(evidence.low[at]), float(evidence.high[at])),
                components=evidence.scattered[at],
            )
        )
    return tuple(found)


def judge(evidence: Evidence) -> list[Diagnostic]:
    """What is to be said of the result."""
    found = _interruption(evidence.trials)
    for at, name in enumerate(evidence.names):
        found += _of_parameter(evidence, at, name)
    if evidence.holdout.nrmse > _UNEXPLAINED:
        found.append(
            Diagnostic(
                "unexplained",
                f"model {evidence.model.name!r} leaves {evidence.holdout.nrmse:.0%} of the torque's spread in blocks "
                "it was not fitted to: torque and deflection have little to do with each other; check units, signs and "
                "that both are of the same joint",
                is_error=True,
            )
        )
    # the exact optimum knows no bounds: at one, the gap is the bound's and not the search's
    at_bounds = any(evidence.at_bound(at) for at in range(len(evidence.names)))
    if evidence.gap > _OPTIMISER_GAP and not at_bounds and not evidence.trials.interrupted:
        found.append(
            Diagnostic(
                "not-converged",
                f"the search ended {evidence.gap:.2g} above the exact optimum: give it more --generations",
                is_error=True,
            )
        )
    return found


def rivals(rungs: tuple[Rung, ...], found: tuple[Estimate, ...]) -> list[Diagnostic]:
    """The terms that were not taken, yet would move Kc or Bc out of its interval: they are not ruled out."""
    told = []
    for rung in rungs:
        for estimate in () if rung.taken else found[:2]:
            value = {"Kc": rung.Kc, "Bc": rung.Bc}[estimate.name]
            if rung.gain > _STRONGLY_AGAINST and not estimate.ci95[0] <= value <= estimate.ci95[1]:
                told.append(
                    Diagnostic(
                        "model-dependent",
                        f"with {rung.term}, which this recording neither asks for nor rules out, {estimate.name} would "
                        f"be {value / estimate.value - 1.0:+.2%} from here, outside its interval: a wider band or a "
                        "larger amplitude would tell",
                        estimate.name,
                    )
                )
    return told


def _interruption(trials: Trials) -> list[Diagnostic]:
    if not trials.interrupted:
        return []
    return [
        Diagnostic(
            "interrupted",
            f"the search was cut short with {int(trials.finished.sum())} of {len(trials.finished)} trials at their "
            "end: the best is the best so far, mean and deviation are over all of them as they stood",
        )
    ]


def _of_parameter(evidence: Evidence, at: int, name: str) -> list[Diagnostic]:
    found, is_error = [], name in _COUPLING
    end = evidence.at_bound(at)
    if end is not None:
        found.append(
            Diagnostic(
                "at-bound",
                f"{name} lies at or beyond the {end} end of its bounds, where the search cannot go; "
                f"widen them with --bounds {name}=LOW:HIGH",
                name,
                is_error=is_error,
            )
        )
    if not evidence.told(at):
        found.append(Diagnostic("not-identifiable", _why_not(evidence, at), name, is_error=is_error))
    elif (name == "Kc" and evidence.values[at] <= 0.0) or (name == "Bc" and evidence.values[at] < 0.0):
        found.append(
            Diagnostic(
                "implausible",
                f"{name} is negative, which no coupling is: {_IMPLAUSIBLE[name]}",
                name,
                is_error=True,
            )
        )
    elif name == "Bc" and evidence.friction_alike > _ONE_SPEED:
        found.append(
            Diagnostic(
                "one-speed",
                f"Bc would hold most of any dry friction, which the model has no term for and which looks like damping "
                f"at one speed: {_SEVERAL_SPEEDS}, and try --model auto",
                name,
            )
        )
    return found


_SEVERAL_SPEEDS = "drive at several speeds (--profile chirp or multisine over two octaves)"
_IMPLAUSIBLE = {
    "Kc": "a sign is wrong; check that a positive torque makes a positive deflection",
    "Bc": "the torque is read later or earlier than the angle, or friction is taken for it; try --model auto",
}


def _why_not(evidence: Evidence, at: int) -> str:
    name, columns, low, high = evidence.names[at], evidence.columns, *evidence.signals.band
    if name in _COUPLING and evidence.unmoved:
        return f"{name} cannot be told: {evidence.unmoved}"
    if not columns[:, at].any():
        return f"{name} cannot be told: nothing in this recording excites it"
    if name == "Bc" and evidence.friction_alike >= _LIKE_FRICTION:
        return f"Bc cannot be told from dry friction: at the one speed driven they look alike; {_SEVERAL_SPEEDS}"
    if evidence.errors.inflation[at] < _CONFUSED and np.isfinite(evidence.errors.half_width[at]):
        if name in _PRESENT:
            return f"{name} cannot be told from zero: its 95 % interval holds it; leave its term out, or excite it more"
        return _too_wide(evidence, at)
    norms = np.linalg.norm(columns, axis=0)
    alike = np.abs(columns.T @ columns[:, at]) / np.where(norms > 0.0, norms, 1.0) / norms[at]
    alike[at] = 0.0
    other = evidence.names[int(np.argmax(alike))]
    return (
        f"{name} cannot be told from {other}: in this recording, {low:.2g} to {high:.2g} Hz, they look alike; drive at "
        "several speeds (--profile chirp or multisine) and over a wider band"
    )


def _too_wide(evidence: Evidence, at: int) -> str:
    """What makes the parameter's interval as wide as its value, and what would narrow it."""
    name, scatter = evidence.names[at], evidence.scattered[at]
    if scatter is not None and scatter.between > _APART * scatter.within:
        return (
            f"{name} cannot be told: the recordings differ by {scatter.between:.2g} (standard deviation) where their "
            f"own errors are {scatter.within:.2g}; see which with hil compare, and pool only those of one joint in the "
            "same units"
        )
    wide = "its 95 % interval is as wide as its value"
    if name == "Bc" and "Fc" in evidence.names:
        return f"Bc cannot be told from Coulomb friction (Fc): {wide}; {_corner(evidence)}{_SEVERAL_SPEEDS}"
    corner = _corner(evidence) if name == "Bc" else ""
    return f"{name} cannot be told: {wide}; {corner}excite it more (--band, --amplitude)"


def _corner(evidence: Evidence) -> str:
    """How fast damping shows: near and above the corner Kc/(2 pi Bc). Empty where the joint moved as fast."""
    if "Kc" not in evidence.names:
        return ""
    kc, bc, high = evidence.names.index("Kc"), evidence.names.index("Bc"), evidence.signals.band[1]
    stiffness, damping = evidence.values[kc], evidence.values[bc] + evidence.errors.half_width[bc]
    if not (stiffness > 0.0 and damping > 0.0):
        return ""
    corner = stiffness / (2.0 * np.pi * damping)
    if high >= corner:
        return ""
    return f"the joint moved at up to {high:.2g} Hz, and damping shows only towards {corner:.2g} Hz: "
