"""A Kc that rests on less torque than the model leaves unexplained."""

from __future__ import annotations

import numpy as np

from hil.diagnostics import Diagnostic
from hil.identification.doubts.misfit import percent
from hil.identification.fitting.described import Described
from hil.uncertainty.criteria import narrow
from hil.uncertainty.misfit import LackOfFit

_ROWS = 20_000  # samples, of which it is seen how much of a column others can make


def outweighed_spring(described: Described, found: LackOfFit | None) -> list[Diagnostic]:
    """Return the error of a Kc that rests on less torque than the model leaves unexplained; none where it does not.

    Friction, play and the other parameters can make most of what a spring that is hardly loaded does: Kc follows from
    the rest of its torque. An effect that the model lacks may look like that rest: it would change Kc by the ratio of
    the two. Noise is averaged away and does not: so a model that the tests do not reject is not doubted, and the noise
    of the reading is not counted. A Kc of zero, its bound, is refused already, with what is wrong.
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
            "spring-outweighed",
            f"of {whole:.2g} N m of torque (standard deviation), only {carried:.2g} N m follows from Kc alone, and not "
            f"from friction, play or the rest of the model. The model leaves {left:.2g} N m unexplained, beyond the "
            f"noise of the reading. An effect of that size can change Kc by {percent(left / carried)}, whatever its "
            "interval says. Drive with several times the torque, so that the spring carries most of it",
            "Kc",
            is_error=True,
        )
    ]


def _carried(described: Described) -> float:
    """The size of the spring's torque, N m r.m.s., without what the columns of the other parameters can make."""
    at = described.names.index("Kc")
    columns = described.columns[:: max(1, len(described.columns) // _ROWS)]
    others, own = np.delete(columns, at, axis=1), columns[:, at]
    sizes = np.linalg.norm(others, axis=0)
    others = others[:, sizes > 0.0] / sizes[sizes > 0.0]
    left = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
    return abs(float(described.values[at])) * float(np.sqrt(np.mean(left**2)))


def _beyond_noise(described: Described) -> float:
    """The size of the residuals without the noise of the reading, N m r.m.s.

    Noise is what differs between readings that follow each other; of it a low-pass lets its part of the band through.
    """
    signals, residuals = described.signals, np.zeros(len(described.signals))
    residuals[described.kept] = described.residuals
    differences = np.diff(signals.as_read - signals.torque + residuals)
    differences = differences[described.kept[1:] & described.kept[:-1]]
    low_pass = signals.window.low_pass if signals.window else None
    passed = 1.0 if low_pass is None or signals.unfiltered is None else min(1.0, 2.0 * low_pass.cut * low_pass.step)
    noise = 0.5 * passed * float(np.mean(differences**2)) if len(differences) else 0.0
    return float(np.sqrt(max(0.0, float(np.mean(described.residuals**2)) - noise)))
