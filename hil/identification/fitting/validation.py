"""Validate a fit: its error on data that it was not made from."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ga.arrays import Array, Index, Mask
from ga.model.record import positive_among
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import distinct as decided
from hil.identification.fitting.dataset import Dataset
from hil.identification.fitting.solution import solved
from hil.identification.result import Validation
from hil.signals import constants as c


def validated(data: Dataset, blocks: Blocks, values: Array, distinct: Mask) -> Validation:
    """Fit 80 % of the samples and return the error on the other 20 %, in blocks of time.

    blocks: the linear problem around the optimum. values (p + q,): the optimum. distinct (p + q,): which parameters are
    fitted; the others keep their values, because the data do not determine them. Raises Untrustworthy as `solved`.
    """

    def is_out(number: Index) -> Mask:
        return np.asarray(number * c.FOLDS // data.samples % (c.FOLDS // 2) == 2)

    def is_in(number: Index) -> Mask:
        return ~is_out(number)

    if data.choice.model.nonlinear:  # such a term may act in a few places, all of them held out
        distinct = distinct & decided(blocks.where(is_in))
    fitted = blocks if distinct.all() else blocks.searching(distinct, values)
    positive = positive_among(
        [one for one, searched in zip(data.choice.model.linear, distinct, strict=False) if searched]
    )
    # the data may decide on no parameter, if a few of the readings are far too large
    genes = solved(fitted.where(is_in), positive).optimum.genes if distinct.any() else np.zeros(0)
    count, absolute, square = 0, 0.0, 0.0
    for columns, target in fitted.where(is_out)():
        residuals = target - columns @ genes
        count += len(target)
        absolute += float(np.abs(residuals).sum())
        square += float(residuals @ residuals)
    # of all samples: the joint may rest in a gap in those held out. The torque itself: of a nonlinear model, the blocks
    # hold the target of its linearisation
    torque = [data.signals.coupling_torque[data.used]] if data.whole else (torque for _, torque in data.blocks())
    variance = _variance(torque)
    return Validation(absolute / count, float(np.sqrt(square / count / variance)) if variance > 0.0 else np.nan)


def _variance(parts: Iterable[Array]) -> float:
    count, total, power = 0, 0.0, 0.0
    for part in parts:
        count += len(part)
        total += float(part.sum())
        power += float(part @ part)
    return power / count - (total / count) ** 2
