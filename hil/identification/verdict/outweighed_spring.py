"""Warn of a Kc whose torque is smaller than the torque that the model leaves unexplained."""

from __future__ import annotations

import numpy as np

from hil.diagnostics import Diagnostic
from hil.identification.candidates.described import Described
from hil.identification.verdict.misfit import percent
from hil.signals.constants import TESTED
from hil.uncertainty.criteria import narrow
from hil.uncertainty.misfit import LackOfFit


def outweighed_spring(described: Described, found: LackOfFit | None) -> list[Diagnostic]:
    """Return the error if the torque that determines Kc is smaller than the torque that the model leaves unexplained;
    else [].

    Friction, play and the other parameters can explain most of the torque of a spring that is hardly loaded: Kc then
    follows from the small remaining torque. An effect that the model lacks may look like that remaining torque, and
    would change Kc by the ratio of the two. Noise is not included, because it averages out, and a model that passes the
    tests is not doubted. A Kc of zero, its bound, has an error of its own.
    """
    if found is None or not (found.misfit or found.is_undecided) or "Kc" not in described.names:
        return []
    if not described.values[described.names.index("Kc")] > 0.0:
        return []
    carried, left = _carried(described), _beyond_noise(described)
    if narrow(left, carried):
        return []
    whole = float(np.std(described.signals.coupling_torque[described.kept]))
    return [
        Diagnostic(
            "little-load",
            f"of {whole:.2g} N m of torque (standard deviation), only {carried:.2g} N m follows from Kc alone, and not "
            f"from friction, play or the rest of the model. The model leaves {left:.2g} N m unexplained, beyond the "
            f"noise of the reading. An effect of that size can change Kc by {percent(left / carried)}, whatever its "
            "interval says. Drive with several times the torque, so that the spring carries most of it",
            "Kc",
            is_error=True,
        )
    ]


def _carried(described: Described) -> float:
    """Return the r.m.s. torque of the spring, N m, after projecting out the columns of the other parameters."""
    at = described.names.index("Kc")
    columns = described.columns[:: max(1, len(described.columns) // TESTED)]
    others, own = np.delete(columns, at, axis=1), columns[:, at]
    sizes = np.linalg.norm(others, axis=0)
    others = others[:, sizes > 0.0] / sizes[sizes > 0.0]
    left = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
    return abs(float(described.values[at])) * float(np.sqrt(np.mean(left**2)))


def _beyond_noise(described: Described) -> float:
    """Return the r.m.s. residual without the noise of the reading, N m.

    The noise is estimated from differences between successive readings. If the readings were low-passed, only the noise
    in the pass band is subtracted.
    """
    signals, residuals = described.signals, np.zeros(len(described.signals))
    residuals[described.kept] = described.residuals
    differences = np.diff(signals.as_read - signals.torque + residuals)
    differences = differences[described.kept[1:] & described.kept[:-1]]
    low_pass = signals.window.low_pass if signals.window else None
    passed = 1.0 if low_pass is None or signals.unfiltered is None else min(1.0, 2.0 * low_pass.cut * low_pass.step)
    noise = 0.5 * passed * float(np.mean(differences**2)) if len(differences) else 0.0
    return float(np.sqrt(max(0.0, float(np.mean(described.residuals**2)) - noise)))
