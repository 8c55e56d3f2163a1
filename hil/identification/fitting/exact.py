"""Solve a linear problem for its exact optimum, or raise the error that no optimum could be proven."""

from __future__ import annotations

from ga.arrays import Array
from ga.lad.out_of_core import Reduced, reduce
from hil.errors import Untrustworthy
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import confidence_intervals


def solved(blocks: Blocks, positive: tuple[int, ...] = ()) -> Reduced:
    """Return the exact optimum of the blocks. positive: the indices of the parameters that must not be negative.

    Raises Untrustworthy if no optimum could be proven.
    """
    try:
        return reduce(blocks, blocks.rows, positive)
    except RuntimeError as error:
        raise unproven(error) from error


def without_signs(blocks: Blocks, values: Array, positive: tuple[int, ...]) -> tuple[Array, Array] | None:
    """Return the optimum (p,) without sign constraints, and its half intervals; None if none of the values (p,) is
    zero.

    positive: the indices of the constrained parameters. Raises Untrustworthy as `solved`.
    """
    if not any(values[at] <= 0.0 for at in positive):
        return None
    found = solved(blocks).optimum.genes
    return found, confidence_intervals(blocks, found).half_width


def unproven(error: RuntimeError) -> Untrustworthy:
    """Return the error for an optimum that could not be proven."""
    return Untrustworthy(f"no exact optimum could be proven ({error}): leave a term out of --model")
