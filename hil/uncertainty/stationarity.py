"""Whether Kc is the same from one end of a recording to the other: a unit that changed, a cable that slipped."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ga.lad.out_of_core import reduce
from hil.diagnostics import Diagnostic
from hil.identification.dataset import Table
from hil.uncertainty.confidence import spread

_PARTS = 4  # of a recording, each of which tells Kc by itself
_DIFFERENT = 3.0  # times, between two parts that tell it
_TOLD = 0.2  # half the width of a part's interval, as a part of its value, up to which the part tells Kc


def unsteady(blocks: Table, edges: tuple[int, ...], at: int) -> list[Diagnostic]:
    """What is to be said where parts of a recording differ in Kc, the parameter at that place, by a multiple.

    blocks: the linear problem that the neighbourhood of the solution looks like; edges: where each recording ends.
    """
    found = []
    for first, last in pairwise((0, *edges)):
        cuts = np.linspace(first, last, _PARTS + 1).astype(int).tolist()
        values = [_stiffness(blocks, start, stop, at) for start, stop in pairwise(cuts)]
        told = [value for value in values if value is not None]
        if told and max(told) > _DIFFERENT * min(told):
            found.append(
                Diagnostic(
                    "unsteady",
                    f"Kc is {min(told):.3g} N m/rad in one quarter of the recording and {max(told):.3g} in another: a "
                    "unit changed, a cable slipped or came loose; look at it with --report, and import or record again",
                    "Kc",
                    is_error=True,
                )
            )
    return found


def _stiffness(blocks: Table, start: int, stop: int, at: int) -> float | None:
    """Kc, N m/rad, of some of the samples; None where they do not tell it."""

    def keep(number: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.asarray((number >= start) & (number < stop))

    try:
        values = reduce(lambda: blocks(keep), stop - start).optimum.genes
    except RuntimeError:  # the columns are too much alike there
        return None
    half = spread(lambda: blocks(keep), values).half_width
    return float(values[at]) if half[at] < _TOLD * values[at] else None
