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

from ga.compiled import compiled_as, compiled_no_refcount, compiled_when_worth, compiled_within
from ga.samples import AT_ONCE, LANES, RESOLUTION, carry, check, in_lanes, in_order, load_block, resolution

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ga.start import Start

ROUNDING = 1e-11
"""The amount by which a lower bound must exceed a limit, relative to its terms: a thousand times the rounding error of
both.
"""

_ROUNDED = 1.0 + 1e-9
"""The factor by which the cube is widened when rows are distinguished, for the rounding of their residuals."""

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
    columns, torque = _as_compiled(columns), _as_compiled(torque)
    p, reach, blocks = columns.shape[1], WIDER * start.reach, -(-len(torque) // LANES)
    work = _Sums(np.empty((p + 3, LANES)), np.zeros((p + 2, LANES)), np.zeros((p + 2, LANES)), np.zeros(p + 2))
    opened = np.empty((blocks, p + 1, LANES))
    with np.errstate(all="ignore"):  # data that are not finite
        count = open_rows(columns, torque, start.centre, start.backward, reach, opened, work)
    filled = -(-count // LANES)
    opened[count // LANES : filled, :, count % LANES :] = 0.0
    *settled, size = work.sums
    if not (np.isfinite(work.sums).all() and np.isfinite(opened[:filled]).all()):
        check(columns, torque)
    return Samples(
        blocks=opened[:filled].copy(),
        length=len(torque),
        floor=max(RESOLUTION * size / len(torque), 1e-300),
        scratch=np.empty((2, LANES)),
        place=np.empty(p),
        origin=_as_compiled(start.centre),
        settled=np.array(settled),
        forward=_as_compiled(start.forward),
        reach=reach,
        columns=columns,
        torque=torque,
    )


def _as_compiled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values as a writable array in one memory layout: for any other layout the search would be compiled
    again.
    """
    return np.require(values, np.float64, ["C", "W"])


class _Sums(NamedTuple):
    """Working space of `collapse`: a block of rows and what is computed of them (p + 3, 128); the sums of the rows that
    keep their sign, multiplied by it, and of the size of every torque: of some blocks, of all (p + 2, 128), and over
    the lanes (p + 2,).
    """

    block: NDArray[np.float64]
    part: NDArray[np.float64]
    total: NDArray[np.float64]
    sums: NDArray[np.float64]


@compiled_when_worth
def open_rows(  # noqa: PLR0917 - compiled functions take their parts by position
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    centre: NDArray[np.float64],
    backward: NDArray[np.float64],
    reach: float,
    opened: NDArray[np.float64],
    work: _Sums,
) -> int:
    """Write the rows that may change sign within the cube to the first of the blocks `opened`, residuals at the centre
    in the place of the torque, and the sums of the others to `work`; return the number of rows written.
    """
    count = 0
    for begin in range(0, len(torque), AT_ONCE):
        part = torque[begin : begin + AT_ONCE]
        count += _open_some(columns[begin : begin + AT_ONCE], part, centre, backward, reach, opened, count, work)
    for k in range(len(work.sums)):
        work.sums[k] = in_order(work.total[k])
    return count


def _open_some(  # noqa: PLR0917 - as above
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    centre: NDArray[np.float64],
    backward: NDArray[np.float64],
    reach: float,
    opened: NDArray[np.float64],
    before: int,
    work: _Sums,
) -> int:
    """Do the same for AT_ONCE rows at most. before: the number of rows that are written already."""
    rows = in_lanes(torque, *columns.T)
    residual, *parts = rows
    size = np.abs(residual).sum(axis=0)
    speed = np.zeros_like(residual)
    for k, column in enumerate(parts):
        residual -= centre[k] * column
        along = np.zeros_like(residual)
        for j in range(k + 1):
            along += parts[j] * backward[j, k]
        speed += np.abs(along, out=along)
    is_open = np.abs(residual) <= speed * (reach * _ROUNDED)
    work.total[:-1] += (np.where(is_open, 0.0, np.where(residual >= 0.0, 1.0, -1.0)) * rows).sum(axis=1)
    work.total[-1] += size
    is_open.flat[len(torque) :] = False  # what fills the lanes up
    found = rows[:, is_open]
    place = before + np.arange(found.shape[1])
    opened[place // LANES, :, place % LANES] = found.T
    return len(place)


@compiled_as(_open_some)
def _open_some_compiled(  # noqa: PLR0917 - as above
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    centre: NDArray[np.float64],
    backward: NDArray[np.float64],
    reach: float,
    opened: NDArray[np.float64],
    before: int,
    work: _Sums,
) -> int:
    """Do the same, to the last bit."""
    n, place = len(torque), before
    size = work.part[-1]
    work.part[:] = 0.0
    for begin in range(0, n, LANES):
        end = min(begin + LANES, n)
        for i in range(end - begin):
            size[i] += abs(torque[begin + i])
        load_block(columns[begin:end], torque[begin:end], centre, work.block)
        _measure(backward, work)
        _settle(reach * _ROUNDED, work)
        place = _write(end - begin, opened, place, work)
    carry(work.part, work.total)
    return place - before


@compiled_within
def _measure(backward: NDArray[np.float64], work: _Sums) -> None:
    """Fill in how much the residuals of a block change on the way to the corner of a cube of half width 1."""
    along, speed = work.block[-2], work.block[-1]
    speed[:] = 0.0
    for k in range(len(backward)):
        along[:] = 0.0
        for j in range(k + 1):
            column, turn = work.block[j], backward[j, k]
            for i in range(LANES):
                along[i] += column[i] * turn
        for i in range(LANES):
            speed[i] += abs(along[i])


@compiled_within
def _settle(reach: float, work: _Sums) -> None:
    """Add the rows of a block that keep their sign to the sums, and put the signs in the place of the speeds: 0 for the
    rows that may change theirs.
    """
    p = len(work.block) - 3
    residual, signs, sums = work.block[p], work.block[-1], work.part[0]
    for i in range(LANES):
        sign = 0.0 if abs(residual[i]) <= signs[i] * reach else 1.0 if residual[i] >= 0.0 else -1.0
        signs[i] = sign
        sums[i] += sign * residual[i]
    for k in range(p):
        column, sums = work.block[k], work.part[k + 1]
        for i in range(LANES):
            sums[i] += signs[i] * column[i]


@compiled_within
def _write(count: int, opened: NDArray[np.float64], place: int, work: _Sums) -> int:
    """Write those of a block's `count` rows that may change their sign; return the place of the next one."""
    p, signs = len(work.block) - 3, work.block[-1]
    for i in range(count):
        if signs[i] == 0.0:
            target = opened[place // LANES, :, place % LANES]
            target[0] = work.block[p, i]
            for k in range(p):
                target[k + 1] = work.block[k, i]
            place += 1
    return place


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


@compiled_when_worth
def dense_errors(samples: Samples, genes: NDArray[np.float64], errors: NDArray[np.float64]) -> None:
    """Fill in equation 5 for chromosomes (m, p), N m."""
    for i in range(len(genes)):
        errors[i] = dense_error(samples, genes[i], np.inf)


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
