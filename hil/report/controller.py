"""What Kc and Bc mean for a controller: corner frequency, resonance of the motor against the coupling, stiffest loop.

docs/controller.md has the formulas and their sources.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ga.model.coupling import CouplingModel
from hil.errors import WrongUse
from hil.report.formatting import Section, people_unit, rounded
from hil.report.identification import equation
from hil.units import with_unit

if TYPE_CHECKING:
    from hil.identification.result import Identification

PHASE_MARGIN = math.radians(60.0)
"""The phase margin, rad, for which the stiffest loop is stated unless another is given."""

_STEP = 1e-4  # of Kc and Bc, for a numerical derivative


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number for a controller, SI: its name, unit, value and 95 % interval, and its meaning in words."""

    name: str
    unit: str
    value: float
    ci95: tuple[float, float]
    meaning: str


@dataclass(frozen=True, slots=True)
class Controller:
    """What Kc and Bc mean for a controller, at the joint.

    quantities: the corner frequency; with a known inertia of the motor also its resonance, damping ratio and the
    stiffest loop. phase_margin: of that loop, rad. inertia: of the motor, kg m^2 at the joint, 0 if unknown. stiffness:
    which Kc was used, in words; "" if the model has a single one.
    """

    quantities: tuple[Quantity, ...]
    phase_margin: float
    inertia: float
    stiffness: str

    def __getitem__(self, name: str) -> Quantity:
        return next(one for one in self.quantities if one.name == name)


def controller(found: Identification, phase_margin: float = PHASE_MARGIN) -> Controller | None:
    """Return what Kc and Bc mean for a controller; None if either may not be trusted, or is not above zero.

    phase_margin: of the stiffest loop, rad. The intervals come from the joint distribution of Kc and Bc; inertia and
    damping of the motor count as exact. Raises WrongUse for a phase margin that is not between 0 and 90 degrees.
    """
    if not 0.0 < phase_margin <= 0.5 * math.pi:
        raise WrongUse(f"phase_margin={phase_margin:g}: give an angle above 0 and up to pi/2, in rad")
    names = [one.name for one in found.estimates]
    if names[:2] != ["Kc", "Bc"] or found.sign_is_wrong or not all(map(found.trusted, ("Kc", "Bc"))):
        return None
    kc, bc = found["Kc"], found["Bc"]
    if min(kc.value, bc.value) <= 0.0:
        return None
    logs = found.covariance[:2, :2] / np.outer([kc.value, bc.value], [kc.value, bc.value])
    inertia, damping = found.signals.motor
    loops = _with_motor(inertia, damping, phase_margin) if inertia else {}
    quantities = tuple(
        _propagated(name, defined, (kc.value, bc.value), logs) for name, defined in (_CORNER | loops).items()
    )
    return Controller(quantities, phase_margin, inertia, _which(found))


def _which(found: Identification) -> str:
    """Return which Kc was used, in words; "" if the model has no other stiffness."""
    if on := found["Kc"].depends_on:
        return f"Kc depends on the {on}: the middle of its range counts, and the intervals span the range"
    return f"{line}: {equation(found.model)}" if (line := constant_part_line(found)) else ""


def constant_part_line(found: Identification) -> str:
    """Return a sentence that Kc is only a part of the stiffness, if the model's other terms change the stiffness; else
    "".
    """
    terms = found.model.terms[1:] if isinstance(found.model, CouplingModel) else ()
    if found.estimates[0].depends_on or not any(
        term.pushed or term.remaining or term.load or term.forgets for term in terms
    ):
        return ""
    return "the stiffness changes with the motion: Kc is its constant part, the factor of x in the model"


_Defined = tuple[str, str, Callable[[float, float], float]]  # unit, meaning, and the formula of Kc and Bc
_CORNER: dict[str, _Defined] = {
    "corner_frequency": (
        "Hz",
        "corner frequency Kc/(2 pi Bc)",
        lambda kc, bc: kc / (2.0 * math.pi * bc),
    )
}


def _with_motor(inertia: float, damping: float, phase_margin: float) -> dict[str, _Defined]:
    """Return the quantities that need the motor's inertia, kg m^2, and damping, N m s/rad, both at the joint."""

    def crossover(kc: float, bc: float) -> float:
        """Return the frequency, rad/s, at which the motor on the coupling lags by 180 degrees less the phase margin."""
        lag = (bc + damping) / math.tan(phase_margin)
        return (lag + math.sqrt(lag**2 + 4.0 * inertia * kc)) / (2.0 * inertia)

    return {
        "resonance_frequency": (
            "Hz",
            "resonance of motor and coupling",
            lambda kc, _bc: math.sqrt(kc / inertia) / (2.0 * math.pi),
        ),
        "damping_ratio": (
            "1",
            "damping ratio of the resonance",
            lambda kc, bc: (bc + damping) / (2.0 * math.sqrt(kc * inertia)),
        ),
        "loop_stiffness": (
            "N*m/rad",
            "highest stiffness of a position loop",
            lambda kc, bc: (bc + damping) * crossover(kc, bc) / math.sin(phase_margin),
        ),
        "loop_bandwidth": (
            "Hz",
            "bandwidth (crossover) of that loop",
            lambda kc, bc: crossover(kc, bc) / (2.0 * math.pi),
        ),
    }


def _propagated(name: str, defined: _Defined, at: tuple[float, float], logs: Any) -> Quantity:
    """Return a quantity with its interval. defined: its unit, meaning and formula. at: Kc and Bc. logs (2, 2): the
    covariance of the logarithms of Kc and Bc.
    """
    (unit, meaning, formula), (kc, bc) = defined, at
    value, up = formula(kc, bc), 1.0 + _STEP
    slopes = np.log(np.array([formula(kc * up, bc), formula(kc, bc * up)]) / value) / math.log(up)
    error = math.sqrt(max(float(slopes @ logs @ slopes), 0.0))
    return Quantity(name, unit, value, (value * math.exp(-1.96 * error), value * math.exp(1.96 * error)), meaning)


def controller_json(found: Identification) -> dict[str, Any] | None:
    """Return the numbers for a controller as a JSON object, SI; None if there are none."""
    made = controller(found)
    if made is None:
        return None
    return {
        "phase_margin": {"value": made.phase_margin, "unit": "rad"},
        "motor_inertia": {"value": made.inertia, "unit": "kg*m^2"} if made.inertia else None,
        "stiffness": made.stiffness or None,
        **{one.name: {"value": one.value, "unit": one.unit, "ci95": list(one.ci95)} for one in made.quantities},
    }


def controller_line(found: Identification) -> str:
    """Return a line about the assumptions behind the numbers for a controller, or why there are no such numbers."""
    made = controller(found)
    if made is None:
        return "no numbers for a controller, because Kc or Bc may not be trusted"
    known = (
        f"joint locked, loop without delay, phase margin {math.degrees(made.phase_margin):.4g} degrees; the motor's "
        f"inertia at the joint, {with_unit(f'{made.inertia:.3g}', 'kg*m^2')}, counts as exact"
    )
    missing = "add motor_inertia to [stand] for the resonance and the stiffest loop"
    return "; ".join(filter(None, [known if made.inertia else missing, made.stiffness]))


def controller_section(found: Identification, *, milli: bool) -> Section:
    """Return the numbers for a controller, if there are any, and below them what they assume, or why there are none."""
    made, rows = controller(found), [("", "value", "95 % interval", "")]
    for one in made.quantities if made else ():
        factor, unit = people_unit(one.unit, milli=milli)
        low, high = (factor * end for end in one.ci95)
        value, first, last, _ = rounded(0.05 * (high - low), factor * one.value, low, high)
        rows.append((one.meaning, value, f"{first} to {last}", unit))
    return Section("for a controller", rows if made else (), (controller_line(found),))
