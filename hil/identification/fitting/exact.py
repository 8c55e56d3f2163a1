"""The exact optimum of a linear problem, or a sentence why none could be proven."""

from __future__ import annotations

from ga.lad.out_of_core import Reduced, reduce
from hil.errors import Untrustworthy
from hil.uncertainty.blocks import Blocks


def solved(blocks: Blocks) -> Reduced:
    """Return the exact optimum of the blocks. Raises Untrustworthy where none could be proven."""
    try:
        return reduce(blocks, blocks.rows)
    except RuntimeError as error:
        raise unproven(error) from error


def unproven(error: RuntimeError) -> Untrustworthy:
    """Return the error of an optimum that could not be proven."""
    return Untrustworthy(f"no exact optimum could be proven ({error}): leave a term out of --model")
