"""The dense engine: the residual of every sample is computed, many at a time in the vector units.

The sum is kept in 128 parallel parts whose order is fixed by the layout, not by the machine: the result is the same to
the last bit on every machine.

A search that begins in a small cube, which almost surely contains the optimum, seldom leaves the cube, and in the cube
most residuals keep their sign. `collapse` replaces these residuals by p + 1 sums. The fraction of the samples that
remains shrinks with the cube: one sixth of 2,500, one in 200 of a million. Outside the cube the same sums bound the
fitness from below (Portnoy and Koenker 1997); if the bound is not enough to reject a chromosome, every sample is
computed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ga.compiled import compiled_no_refcount, compiled_within
from ga.samples import LANES, check, in_lanes, resolution

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ga.start import Start

ROUNDING = 1e-11
"""The amount by which a lower bound must exceed a limit, relative to its terms: a thousand times the rounding error of
both.
"""

_AT_ONCE = LANES << 6
"""The number of rows that are collapsed at a time: their working space stays in the processor's cache."""

WIDER = 1.5
"""The ratio of the width of the collapsed cube to that of the cube in which the search begins: children overshoot their
parents.
"""


class Samples(NamedTuple):
    """Columns and torque of one recording, in the form in which the fitness is computed.

    blocks (ceil(m/128), p + 1, 128): the m rows that are computed one by one: the residual at the origin, then the
    columns, padded with zero rows, which add nothing to a sum. length: n. floor: the smallest divisor, N m, in relative
    comparisons of fitness. scratch (2, 128) and place (p,): working space. settled (p + 1,): the sums of the other
    rows, each multiplied by the sign of its residual; they are valid in the cube |forward (genes - origin)| <= reach.
    columns (n, p), torque (n,): all rows, for chromosomes outside the cube.
    """

    blocks: NDArray[np.float64]
    length: int
    floor: float
    scratch: NDArray[np.float64]
    place: NDArray[np.float64]
    origin: NDArray[np.float64]
    settled: NDArray[np.float64]
    forward: NDArray[np.float64]
    reach: float
    columns: NDArray[np.float64]
    torque: NDArray[np.float64]


def pack(columns: NDArray[np.float64], torque: NDArray[np.float64]) -> Samples:
    """Return the samples of columns (n, p) and torque (n,), N m, with no rows collapsed. Raises ValueError if the data
    are not finite, not of equal length or empty.
    """
    check(columns, torque)
    p = columns.shape[1]
    return Samples(
        blocks=_blocks(torque, *columns.T),
        length=len(torque),
        floor=resolution(torque),
        scratch=np.empty((2, LANES)),
        place=np.empty(p),
        origin=np.zeros(p),
        settled=np.zeros(p + 1),
        forward=np.eye(p),
        reach=np.inf,
        columns=np.empty((0, p)),
        torque=np.empty(0),
    )


def collapse(columns: NDArray[np.float64], torque: NDArray[np.float64], start: Start) -> Samples:
    """Return the samples of columns (n, p) and torque (n,), N m. Rows whose residuals keep their sign around the start
    are replaced by sums.

    Raises ValueError if the data are not finite, not of equal length or empty.
    """
    check(columns, torque)
    p, reach = columns.shape[1], WIDER * start.reach
    opened, settled = [], np.zeros((p + 1, LANES))
    for begin in range(0, len(torque), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        rows = in_lanes(torque[part], *columns[part].T)
        is_open = _opened(rows, start, reach)
        settled += (np.where(is_open, 0.0, np.where(rows[0] >= 0.0, 1.0, -1.0)) * rows).sum(axis=1)
        is_open.flat[len(torque) - begin :] = False  # what fills the lanes up
        opened.append(rows[:, is_open])
    return Samples(
        blocks=_blocks(*np.hstack(opened)),
        length=len(torque),
        floor=resolution(torque),
        scratch=np.empty((2, LANES)),
        place=np.empty(p),
        origin=_as_compiled(start.centre),
        settled=settled.cumsum(axis=1)[:, -1].copy(),
        forward=_as_compiled(start.forward),
        reach=reach,
        columns=_as_compiled(columns),
        torque=_as_compiled(torque),
    )


def _as_compiled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values as a writable array in one memory layout: for any other layout the search would be compiled
    again.
    """
    return np.require(values, np.float64, ["C", "W"])


def _opened(rows: NDArray[np.float64], start: Start, reach: float) -> NDArray[np.bool_]:
    """Return which of the rows (p + 1, m, 128) of torque and columns may change sign within the cube, and put their
    residuals at the start, N m, in the place of the torque. reach: half the cube's width, N m.
    """
    residual, *columns = rows
    speed = np.zeros_like(residual)
    for k, column in enumerate(columns):
        residual -= column * start.centre[k]
        along = columns[0] * start.backward[0, k]
        for j in range(1, k + 1):
            along += columns[j] * start.backward[j, k]
        speed += np.abs(along, out=along)
    speed *= reach * (1.0 + 1e-9)
    return np.asarray(np.abs(residual) <= speed)


def _blocks(*rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return torque and columns, (m,) each, as the field `blocks` of `Samples`."""
    return np.ascontiguousarray(in_lanes(*rows).transpose(1, 0, 2))


def shared(samples: Samples) -> Samples:
    """Return the same samples with separate working space, for another thread."""
    return samples._replace(scratch=np.empty_like(samples.scratch), place=np.empty_like(samples.place))


@compiled_no_refcount
def dense_error(samples: Samples, genes: NDArray[np.float64], limit: float) -> float:
    """Return equation 5 for one chromosome (p,), N m; the result may be infinite if the error exceeds the limit."""
    for k in range(genes.size):
        samples.place[k] = genes[k] - samples.origin[k]
    error = abs(_settled(samples)) + _open_error(samples)
    if _is_near(samples):
        return error / samples.length
    if error * (1.0 - ROUNDING) > limit * samples.length:  # a bound from below
        return np.inf
    return _plain_error(samples, genes)


@compiled_within
def _open_error(samples: Samples) -> float:
    """Return the sum of the absolute residuals of the rows that are computed one by one."""
    # plain indices and scalars: an iterated block or an indexed gene in the inner loop keeps it from the vector units
    total, residual, place = samples.scratch[0], samples.scratch[1], samples.place
    for j in range(LANES):
        total[j] = 0.0
    for b in range(samples.blocks.shape[0]):
        gene, torque, column = place[0], samples.blocks[b, 0], samples.blocks[b, 1]
        if place.size == 2:  # the paper's model, in one pass
            damping, rate = place[1], samples.blocks[b, 2]
            for j in range(LANES):
                total[j] += abs(torque[j] - gene * column[j] - damping * rate[j])
            continue
        for j in range(LANES):
            residual[j] = torque[j] - gene * column[j]
        for k in range(1, place.size):
            gene, column = place[k], samples.blocks[b, k + 1]
            for j in range(LANES):
                residual[j] -= gene * column[j]
        for j in range(LANES):
            total[j] += abs(residual[j])
    return _folded(total)


@compiled_within
def _settled(samples: Samples) -> float:
    error: float = samples.settled[0]
    for k in range(samples.place.size):
        error -= samples.settled[k + 1] * samples.place[k]
    return error


@compiled_within
def _folded(total: NDArray[np.float64]) -> float:
    """Return the sum of 128 numbers, which are overwritten."""
    width = LANES // 2
    while width >= 8:
        for j in range(width):
            total[j] += total[j + width]
        width //= 2
    error = 0.0
    for j in range(8):
        error += total[j]
    return error


@compiled_within
def _is_near(samples: Samples) -> bool:
    for k in range(samples.place.size):
        along = 0.0
        for j in range(k, samples.place.size):
            along += samples.forward[k, j] * samples.place[j]
        if abs(along) > samples.reach:  # what is not a number stays one
            return False
    return True


@compiled_within
def _plain_error(samples: Samples, genes: NDArray[np.float64]) -> float:
    """Return equation 5 for one chromosome, N m, computed row by row from all rows."""
    total = part = 0.0
    for i in range(samples.length):
        residual = samples.torque[i]
        for k in range(genes.size):
            residual -= samples.columns[i, k] * genes[k]
        part += abs(residual)
        if i % LANES == LANES - 1:
            total, part = total + part, 0.0
    return (total + part) / samples.length


@compiled_no_refcount
def dense_tangent(samples: Samples, genes: NDArray[np.float64], slope: NDArray[np.float64]) -> float:
    """Return the height, N m, at a chromosome (p,) of a plane below the fitness; its slope (p,) is written to `slope`.

    The plane touches the fitness at the chromosome, unless the samples are collapsed and the chromosome is outside
    their cube.
    """
    place = samples.place
    for k in range(genes.size):
        place[k] = genes[k] - samples.origin[k]
    height = abs(_settled(samples))
    sign = np.sign(_settled(samples))
    for k in range(genes.size):
        slope[k] = -sign * samples.settled[k + 1] / samples.length
    for b in range(samples.blocks.shape[0]):
        for j in range(LANES):
            residual = samples.blocks[b, 0, j]
            for k in range(genes.size):
                residual -= samples.blocks[b, k + 1, j] * place[k]
            height += abs(residual)
            for k in range(genes.size):
                slope[k] -= np.sign(residual) * samples.blocks[b, k + 1, j] / samples.length
    return height / samples.length
