"""The dense engine: every sample is looked at, side by side in the vector units.

The sum is kept in 128 parallel parts whose order is fixed by the layout, not by the machine: the result is the same to
the last bit everywhere.

Where a search begins in a small cube that all but surely holds the optimum, it seldom leaves it, and in it most
residuals keep their sign. `collapse` puts those into p + 1 sums, which leaves a share of the samples that shrinks with
the cube: one sixth of 2,500, one in 200 of a million. Outside of the cube the same sums bound the fitness from below
(Portnoy and Koenker 1997); where that is not enough to turn a chromosome down, every sample is looked at after all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ga.compiled import compiled_no_refcount, compiled_within
from ga.samples import check, resolution

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ga.start import Start

LANES = 128
"""Samples in a block: the number of partial sums."""

ROUNDING = 1e-11
"""How far beyond a limit, relative to its terms, a bound must be: a thousand times what rounding makes of both."""

WIDER = 1.5
"""Half-width of the cube that is collapsed over that of the cube begun in: children overshoot their parents."""


class Samples(NamedTuple):
    """Columns and torque of one recording, ready to be evaluated.

    blocks: (ceil(m/128), p + 1, 128), the residual at the origin, then the columns, of the m rows to be looked at,
    padded with zero rows, which add nothing to a sum. length: n. floor: N m, the least fitness that relative
    comparisons divide by. scratch: (2, 128) and place: (p,), working space.
    settled: (p + 1,), the same of the rows that are not looked at, each with the sign of its residual, summed up, where
    |forward (genes - origin)| <= reach in every coordinate. columns (n, p), torque (n,): all rows, for elsewhere.
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
    """The samples of columns (n, p) and torque (n,), N m. Raises ValueError as `check` does."""
    check(columns, torque)
    count, p = columns.shape
    rows = -(-count // LANES)
    padded = np.zeros((p + 1, rows * LANES))
    padded[0, :count] = torque
    padded[1:, :count] = columns.T
    blocks = np.ascontiguousarray(padded.reshape(p + 1, rows, LANES).transpose(1, 0, 2))
    return Samples(
        blocks=blocks,
        length=count,
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
    """The samples of columns (n, p) and torque (n,), N m, collapsed around a start. Raises ValueError as `check`."""
    check(columns, torque)
    p, reach = columns.shape[1], WIDER * start.reach
    open_rows, settled = np.empty(len(torque), np.int32), np.zeros(p + 1)
    if p == 2:
        count = settle_two(columns, torque, start.centre, start.backward, reach, open_rows, settled)
    else:
        count = settle_any(columns, torque, start.centre, start.backward, reach, open_rows, settled, np.zeros(p + 1))
    blocks = np.zeros((-(-count // LANES), p + 1, LANES))
    fill(columns, torque, start.centre, open_rows[:count], blocks)
    return Samples(
        blocks=blocks,
        length=len(torque),
        floor=resolution(torque),
        scratch=np.empty((2, LANES)),
        place=np.empty(p),
        origin=start.centre,
        settled=settled,
        forward=start.forward,
        reach=reach,
        columns=columns,
        torque=torque,
    )


def shared(samples: Samples) -> Samples:
    """Return the samples with working space of their own."""
    return samples._replace(scratch=np.empty_like(samples.scratch), place=np.empty_like(samples.place))


@compiled_no_refcount
def settle_any(  # noqa: PLR0917 - compiled functions take their parts by position
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    origin: NDArray[np.float64],
    backward: NDArray[np.float64],
    reach: float,
    open_rows: NDArray[np.int32],
    settled: NDArray[np.float64],
    part: NDArray[np.float64],
) -> int:
    """List the rows that may change sign in the cube and sum up the others; returns how many were listed.

    part: (p + 1,) of zeros, working space.
    """
    n, p = columns.shape
    count = 0
    for i in range(n):
        residual, speed = torque[i], 0.0
        for k in range(p):
            residual -= columns[i, k] * origin[k]
            along = 0.0
            for j in range(k + 1):
                along += columns[i, j] * backward[j, k]
            speed += abs(along)
        if abs(residual) <= reach * speed * (1.0 + 1e-9):
            open_rows[count] = i
            count += 1
        else:
            sign = 1.0 if residual >= 0.0 else -1.0
            part[0] += abs(residual)
            for k in range(p):
                part[k + 1] += sign * columns[i, k]
        if i % LANES == LANES - 1 or i == n - 1:  # sums of sums: a million terms one by one would lose digits
            for k in range(p + 1):
                settled[k] += part[k]
                part[k] = 0.0
    return count


@compiled_no_refcount
def settle_two(  # noqa: PLR0917 - compiled functions take their parts by position
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    origin: NDArray[np.float64],
    backward: NDArray[np.float64],
    reach: float,
    open_rows: NDArray[np.int32],
    settled: NDArray[np.float64],
) -> int:
    """Compute it for two columns, in registers: four times as fast."""
    count, wide = 0, reach * (1.0 + 1e-9)
    for begin in range(0, len(torque), LANES):
        sizes = firsts = seconds = 0.0
        for i in range(begin, min(begin + LANES, len(torque))):
            a, b = columns[i, 0], columns[i, 1]
            residual = torque[i] - a * origin[0] - b * origin[1]
            size = abs(residual)
            if size <= wide * (abs(a * backward[0, 0]) + abs(a * backward[0, 1] + b * backward[1, 1])):
                open_rows[count] = i
                count += 1
            else:
                sizes += size
                firsts += a if residual >= 0.0 else -a
                seconds += b if residual >= 0.0 else -b
        settled[0] += sizes
        settled[1] += firsts
        settled[2] += seconds
    return count


@compiled_no_refcount
def fill(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    origin: NDArray[np.float64],
    rows: NDArray[np.int32],
    blocks: NDArray[np.float64],
) -> None:
    """Put the rows side by side, in blocks, with their residuals at the origin."""
    for i in range(rows.size):
        residual = torque[rows[i]]
        for k in range(origin.size):
            residual -= columns[rows[i], k] * origin[k]
            blocks[i // LANES, k + 1, i % LANES] = columns[rows[i], k]
        blocks[i // LANES, 0, i % LANES] = residual


@compiled_within
def dense_error(samples: Samples, genes: NDArray[np.float64], limit: float) -> float:
    """Equation 5 for one chromosome (p,), N m; infinite, perhaps, where it exceeds the limit."""
    for k in range(genes.size):
        samples.place[k] = genes[k] - samples.origin[k]
    error = abs(_settled(samples)) + _open_error(samples)
    if _is_near(samples):
        return error / samples.length
    if error * (1.0 - ROUNDING) > limit * samples.length:  # a bound from below
        return np.inf
    return _plain_error(samples, genes)


@compiled_no_refcount
def _open_error(samples: Samples) -> float:
    """The sum of the absolute residuals of the rows that are looked at."""
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


@compiled_no_refcount
def _folded(total: NDArray[np.float64]) -> float:
    """The sum of 128 numbers, which it overwrites."""
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
    """Equation 5 row by row."""
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
    """A plane below the fitness: its height, N m, at a chromosome (p,), and its slope (p,), written to `slope`.

    It touches the fitness there, unless the samples are collapsed and the chromosome is out of their cube.
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
