"""A result without the compliance of the fixture that held the joint, which a recording of the empty rig tells."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse
from hil.identification.compare import standard_error
from hil.identification.dataset import torque_uncertainty
from hil.identification.identifiability import TOLD
from hil.identification.model_choice import Coupling
from hil.identification.result import Estimate, Fixture, Identification
from hil.identification.same_stand import check_together
from hil.uncertainty.series_compliance import Element, Excitation, corrected

_NORMAL = 1.96
_CORRECTED = ("Kc", "Bc")


def check_rig(recordings: list[Path], rig: Path, model: Coupling | None) -> list[Diagnostic]:
    """What is to be said of an empty-rig recording beside those of the joint.

    Raises WrongUse where it is of another stand or one of them, and for a model without Kc and Bc.
    """
    names = _CORRECTED if model is None else [parameter.name for parameter in (*model.linear, *model.shape)]
    if model is not None and not set(_CORRECTED) <= set(names):
        raise WrongUse(
            f"--fixture is taken off Kc and Bc, and model {model.name!r} has {', '.join(names)}: name them so in the "
            "model, or leave the option out"
        )
    return check_together([recordings[0], rig])


def without_fixture(found: Identification, fixture: Identification) -> Identification:
    """Kc and Bc of the joint alone, with the errors of both recordings in their intervals.

    What there is to say of the fixture's recording is in the diagnostics, and so is a parameter that cannot be told any
    more. Raises Untrustworthy where the fixture is softer than the joint, or its own recording does not tell Kc.
    """
    if not fixture["Kc"].identifiable:
        why = next((one.message for one in fixture.diagnostics if one.is_error), "it is not told from noise")
        raise Untrustworthy(f"{fixture.recordings[0]} cannot tell the stiffness of the fixture: {why}")
    signals = found.signals
    one = len(found.recordings) == 1 and len(signals) >= found.samples
    moved = Excitation.of(signals.time, signals.dtheta) if one else Excitation.flat(signals.band)
    # the torque's scale is wrong by the same part in both, and so in what is left
    common = max(torque_uncertainty(path) for path in found.recordings)
    alone = corrected(_element(found, common), _element(fixture, common), moved)
    corrections = {"Kc": (alone.stiffness, alone.stiffness_error), "Bc": (alone.damping, alone.damping_error)}
    estimates = tuple(
        _moved(estimate, *corrections[estimate.name], common) if estimate.name in corrections else estimate
        for estimate in found.estimates
    )
    lost = [
        _lost(after)
        for before, after in zip(found.estimates, estimates, strict=True)
        if before.identifiable and not after.identifiable
    ]
    return replace(
        found,
        estimates=estimates,
        diagnostics=(*found.diagnostics, *_of_fixture(fixture), *lost),
        fixture=Fixture(fixture.recordings[0], fixture.model.name, tuple(fixture[name] for name in _CORRECTED)),
    )


def _of_fixture(fixture: Identification) -> list[Diagnostic]:
    """What was found of the fixture; a damping of it that cannot be told is in the intervals and ends nothing."""
    return [
        Diagnostic(
            one.code,
            f"{fixture.recordings[0]}, the fixture: {one.message}",
            one.parameter,
            is_error=one.is_error and (one.code, one.parameter) != ("not-identifiable", "Bc"),
        )
        for one in fixture.diagnostics
    ]


def _lost(estimate: Estimate) -> Diagnostic:
    return Diagnostic(
        "not-identifiable",
        f"{estimate.name} of the joint cannot be told from what the fixture gives: without it, the 95 % interval is as "
        "wide as the value; stiffen the fixture, or record both for longer and over a wider band",
        estimate.name,
        is_error=True,
    )


def _element(found: Identification, common: float) -> Element:
    kc, bc = found["Kc"], found["Bc"]
    return Element(kc.exact, bc.exact, standard_error(kc, common), standard_error(bc, common))


def _moved(estimate: Estimate, exact: float, error: float, common: float) -> Estimate:
    shift, half = exact - estimate.exact, _NORMAL * math.hypot(error, common * exact)
    return replace(
        estimate,
        value=estimate.value + shift,
        exact=exact,
        ci95=(exact - half, exact + half),
        trials_mean=estimate.trials_mean + shift,
        identifiable=estimate.identifiable and bool(half < TOLD * exact),
    )
