"""A result without the compliance of the fixture that held the joint, which a recording of the empty rig tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.fixture import Element, Excitation, corrected
from hil.result import Estimate, Identification

_NORMAL = 1.96


def without_fixture(found: Identification, fixture: Identification) -> Identification:
    """Kc and Bc of the joint alone, with the errors of both recordings in their intervals.

    Raises Untrustworthy where the fixture is softer than the joint.
    """
    signals = found.signals
    one = len(found.recordings) == 1 and len(signals) == found.samples
    moved = Excitation.of(signals.time, signals.dtheta) if one else Excitation.flat(signals.band)
    alone = corrected(_element(found), _element(fixture), moved)
    corrections = {"Kc": (alone.stiffness, alone.stiffness_error), "Bc": (alone.damping, alone.damping_error)}
    estimates = tuple(
        _moved(estimate, *corrections[estimate.name]) if estimate.name in corrections else estimate
        for estimate in found.estimates
    )
    return replace(found, estimates=estimates)


def _element(found: Identification) -> Element:
    kc, bc = found["Kc"], found["Bc"]
    return Element(kc.exact, bc.exact, _error(kc), _error(bc))


def _error(estimate: Estimate) -> float:
    return 0.5 * (estimate.ci95[1] - estimate.ci95[0]) / _NORMAL


def _moved(estimate: Estimate, exact: float, error: float) -> Estimate:
    shift, half = exact - estimate.exact, _NORMAL * error if np.isfinite(error) else np.inf
    return replace(
        estimate,
        value=estimate.value + shift,
        exact=exact,
        ci95=(exact - half, exact + half),
        trials_mean=estimate.trials_mean + shift,
        identifiable=estimate.identifiable and bool(np.isfinite(half)),
    )
