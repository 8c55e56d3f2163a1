"""Correct Kc and Bc for errors of the deflection: the change, its summary and its diagnostics."""

from __future__ import annotations

import numpy as np

from ga.arrays import Array
from hil.diagnostics import Diagnostic
from hil.identification.deflection.correction import DeflectionErrors
from hil.identification.deflection.instruments import is_instrument
from hil.identification.misfit.dynamic_stiffness import DynamicStiffness
from hil.identification.result import Deflection
from hil.identification.verdict.evidence import Evidence
from hil.signals import constants as c
from hil.signals.prepare import Signals

_IMPORTED = ", or name its column with --command"
_REMEDY = "use a larger amplitude or a finer encoder"


def summarised(evidence: Evidence) -> Deflection | None:
    """Return the summary of the errors of the deflection for the result; None if they are too small to have an
    effect.
    """
    found = evidence.deflection
    if found is None or (found.method == "none" and found.low_pass is None):
        return None
    return Deflection(
        noise=found.noise,
        counts=found.counts,
        low_pass=found.low_pass,
        method=found.method,
        strength=found.strength,
        before={name: -one for name, one in _relative(evidence, found.change).items()},
        predicted={name: -one for name, one in _relative(evidence, found.predicted).items()},
    )


def deflection_diagnostics(evidence: Evidence) -> list[Diagnostic]:
    """Return warnings if the correction of Kc or Bc is large, and errors if the correction is impossible."""
    found = evidence.deflection
    if found is None:
        return []
    if found.counts < c.FEW_COUNTS / (4.0 if found.method == "instruments" else 2.0) and "Bc" in evidence.names:
        text = f"the deflection spans {found.counts:.0f} counts of the encoder. Bc cannot be identified: {_REMEDY}"
        return [Diagnostic("deflection-noise", text, "Bc", is_error=True)]
    if found.method == "none":
        return []
    changes = _relative(evidence, found.change)
    most = c.INTERVAL if found.method == "instruments" else c.FIRST_ORDER
    said = [
        Diagnostic("deflection-noise", f"{_cause(found)}. {name} cannot be identified: {_REMEDY}", name, is_error=True)
        for name, change in changes.items()
        if not abs(change) < most
    ]
    sizes = [abs(changes.get(name, 0.0)) for name in c.COUPLING]
    if not said and any(size > least for size, least in zip(sizes, c.RELEVANT, strict=True)):
        how = "the command" if found.method == "instruments" else "a simulation of the noise, which is less accurate"
        moved = " and ".join(f"{name} by {100.0 * change:+.2g} %" for name, change in changes.items())
        text = f"{_cause(found)}. They are corrected with {how}: {moved}. To need less correction, {_REMEDY}"
        said.append(Diagnostic("deflection-noise", text))
    if found.is_weak:
        text = (
            "the motion hardly follows the recorded command. The noise of the deflection is therefore corrected with a "
            "simulation, and Kc and Bc are less accurate. Record the set-point that was driven"
        )
        said.append(Diagnostic("deflection-noise", text))
    return said


def ignored_command(signals: Signals, found: DynamicStiffness | None) -> list[Diagnostic]:
    """Return the warning that a command was recorded but not used, because the motion does not follow it."""
    if found is None or found.instrument == "command" or not is_instrument(signals.command):
        return []
    text = (
        "the motion does not follow the recorded command, so it is not used. Kc and Bc are less accurate where "
        f"the deflection is noisy. Record the set-point that was driven{_IMPORTED if signals.imported else ''}"
    )
    return [Diagnostic("deflection-noise", text)]


def _cause(found: DeflectionErrors) -> str:
    return f"noise of {1e3 * found.noise:.2g} mrad in the deflection makes Kc and Bc too small"


def _relative(evidence: Evidence, change: Array) -> dict[str, float]:
    """Return the part of a change (p + q,) that concerns Kc and Bc, by name, relative to their corrected values."""
    found: dict[str, float] = {}
    for name in c.COUPLING:
        if name in evidence.names:
            at = evidence.names.index(name)
            value = float(evidence.values[at])
            found[name] = float(change[at]) / abs(value) if value else np.inf
    return found
