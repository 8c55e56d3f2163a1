"""Signals that depend on earlier samples: a lag, and the frictions of Dahl and of Bouc and Wen, exact for uneven
stamps.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from ga.arrays import Array, Index
from ga.compiled import compiled_no_refcount, compiled_within

_FORGOTTEN: Final = 1e-6
"""The fraction of a state below which the state has no effect any more."""

_SAME: Final = 1e-9
"""The fraction of the time between two samples below which a time has only an effect in proportion to it."""

_AT_ONCE: Final = 1e-6
"""The width, s, below which a mean over that time equals the value itself."""


def lagged(time: Array, values: Array, constant: float) -> Array:
    """Return values (n,) or (n, k) behind a first-order lag of `constant`, s, that has settled at the first sample.

    time (n,): s. Exact if the values are cubic between two times, with slopes from central differences.
    """
    if len(time) < 2:
        return values
    table = np.ascontiguousarray(values.reshape(len(time), -1), dtype=np.float64)
    found, chord = np.empty_like(table), (table[1] - table[0]) / (time[1] - time[0])
    found[0] = table[0]
    lag_behind(np.ascontiguousarray(time), table, constant, found, chord, chord.copy())
    return found.reshape(values.shape)


def averaged(time: Array, values: Array, width: float, rows: Index | None = None) -> Array:
    """Return the mean of values (n,) or (n, k) over `width`, s, around each time; at the ends, over the part of it that
    exists.

    time (n,): s. rows (m,): the times for which the mean is returned; None: all. The values are cubic between two
    times, with slopes from central differences.
    """
    rows = np.arange(len(time)) if rows is None else rows
    if len(time) < 2:
        return values[rows]
    table = np.ascontiguousarray(values.reshape(len(time), -1), dtype=np.float64)
    (slopes, areas), found = np.zeros((2, *table.shape)), np.empty((len(rows), table.shape[1]))
    add_up(np.ascontiguousarray(time), table, slopes, areas)
    mean_around(np.ascontiguousarray(time), table, slopes, areas, width, rows, found)
    return found.reshape(len(rows), *values.shape[1:])


def with_turns(time: Array, rate: Array) -> tuple[Array, Array, Index]:
    """Return times (m,), s, and rates, rad/s, with an additional sample at each reversal, and the indices of the given
    samples (n,).

    At a reversal the rate, linear between two samples, is zero. Friction that builds up over a deflection depends on
    the distance in each direction: from the difference of the two alone, the joint would seem hardly to have moved.
    """
    turning = rate[:-1] * rate[1:] < 0.0
    turns, rows = np.flatnonzero(turning), np.arange(len(time))
    if not len(turns):
        return time, rate, rows
    rows[1:] += np.cumsum(turning)
    shares = rate[turns] / (rate[turns] - rate[turns + 1])
    times, rates = np.zeros((2, len(time) + len(turns)))
    times[rows], rates[rows] = time, rate
    times[rows[turns] + 1] = time[turns] + shares * (time[turns + 1] - time[turns])
    return times, rates, rows


def presliding(time: Array, rate: Array, length: float) -> Array:
    """Return Dahl's friction (n,), -1 to 1, of a rate (n,), rad/s.

    It follows dz/dx = (1 - z sign(rate))/length, with length in rad, and begins with zero.
    """
    moves = np.diff(time) * 0.5 * (rate[:-1] + rate[1:])
    keep = np.exp(-np.abs(moves) / length)
    found = np.zeros(len(time))
    slide_along(keep, (1.0 - keep) * np.sign(moves), found)
    return found


def bristles(time: Array, rate: Array, length: float, rise: float, over: float) -> Array:
    """Return LuGre's friction (n,), 1 at speed, of a rate (n,), rad/s.

    It follows dz/dx = (1 - z sign(rate)/g)/length and begins with zero. Its final value, g = 1 + rise
    exp(-(rate/over)^2), is linear in the distance between two samples (Canudas de Wit and others 1995).
    """
    moves = np.diff(time) * 0.5 * (rate[:-1] + rate[1:])
    settled = 1.0 + rise * falls(rate, over)
    ways = np.maximum(np.abs(moves) * 2.0 / (length * (settled[:-1] + settled[1:])), _SAME)
    keep = np.exp(-ways)
    added = settled[1:] - keep * settled[:-1] - np.diff(settled) * (1.0 - keep) / ways
    found = np.zeros(len(time))
    slide_along(keep, added * np.sign(moves), found)
    return found


def falls(rate: Array, over: float) -> Array:
    """Return the fraction (n,) of friction's excess at rest over friction at speed that remains at a rate: a Gaussian.

    over: the width of the Gaussian, rad/s.
    """
    return np.asarray(np.exp(-((rate / over) ** 2)))


def yielding(time: Array, rate: Array, length: float) -> Array:
    """Return Bouc and Wen's friction (n,), -1 to 1, of a rate (n,), rad/s, beginning with zero.

    It follows dz/dx = 1/length while the motion reduces |z|, and (1 - |z|)/length while the motion increases |z|.
    """
    found = np.zeros(len(time))
    yield_along(np.diff(time) * 0.5 * (rate[:-1] + rate[1:]) / length, found)
    return found


Beginnings = tuple[tuple[slice, "Array"], ...]
"""The signals that the unknown states at the beginning of pieces can cause.

For each piece: the rows in which its initial state matters, and a basis (m, k) of the signals that the state can cause.
"""


def beginnings(left: Array, stretch: Index) -> Beginnings:
    """Return the signals that the unknown states at the beginning of each piece can cause.

    left (k, n): the weight that the initial state of its piece still has at each sample, which only falls. stretch
    (n,): the number of the piece of each sample.
    """
    near = np.flatnonzero(left.max(axis=0) > _FORGOTTEN)
    edges = np.flatnonzero(np.diff(stretch[near])) + 1
    parts = (slice(rows[0], rows[-1] + 1) for rows in (np.split(near, edges) if len(near) else []))
    return tuple((rows, _orthonormal(left[:, rows].T)) for rows in parts)


def without_beginnings(values: Array, begun: Beginnings) -> Array:
    """Return values (n,) or (n, p) without the part that the unknown states at the beginning of each piece can cause.
    begun: from `beginnings`.

    By the theorem of Frisch and Waugh (1933), a least-squares fit to the result equals the fit in which these states
    are parameters.
    """
    found = values.copy()
    for rows, basis in begun:
        found[rows] -= basis @ (basis.T @ found[rows])
    return found


def _orthonormal(left: Array) -> Array:
    """Return an orthonormal basis of the space that the columns (n, k) span. A single column is only scaled, because QR
    takes ten times as long.
    """
    return np.asarray(left / np.linalg.norm(left)) if left.shape[1] == 1 else np.linalg.qr(left)[0]


@compiled_no_refcount
def yield_along(moves: Array, found: Array) -> None:
    """Fill in the states (n + 1,) of Bouc and Wen's friction after the first. moves (n,): distances, in units of the
    length.
    """
    for at in range(len(moves)):
        way, load = abs(moves[at]), found[at] if moves[at] >= 0.0 else -found[at]
        unloading = min(way, max(-load, 0.0))
        load += unloading
        if way > unloading:
            load = 1.0 - (1.0 - load) * np.exp(unloading - way)
        found[at + 1] = load if moves[at] >= 0.0 else -load


@compiled_no_refcount
def lag_behind(time: Array, table: Array, constant: float, found: Array, chord: Array, slope: Array) -> None:  # noqa: PLR0917 - compiled functions take their parts by position
    """Fill in the result of `lagged` for values (n, k).

    chord, slope (k,): slope to the next sample and derivative, both at the first sample. The code works element by
    element: a copy of a row takes two seconds to compile, because the errors that it could raise are compiled too.
    """
    count, width = table.shape
    last = same = 0.0
    for at in range(count - 1):
        step = time[at + 1] - time[at]
        following = time[at + 2] - time[at + 1] if at + 2 < count else step
        part, per_part, per_following = constant / step, step / constant, 1.0 / following
        if abs(step - last) > _SAME * step:  # exp takes most of the time, and even stamps differ by rounding
            last, same = step, np.exp(-step / constant)
        keep = same * (1.0 - (step - last) / constant)
        share = following / (step + following)
        for k in range(width):
            beyond = (table[at + 2, k] - table[at + 1, k]) * per_following if at + 2 < count else chord[k]
            next_slope = share * chord[k] + (1.0 - share) * beyond
            # a cubic less its slopes, p - T p' + T^2 p'' - T^3 p''', is what the lag has settled to; the rest decays
            third = 2.0 * 3.0 * (slope[k] + next_slope - 2.0 * chord[k]) * part
            second = 2.0 * (3.0 * chord[k] - 2.0 * slope[k] - next_slope)
            begin = table[at, k] + constant * (part * (second - third) - slope[k])
            end = table[at + 1, k] + constant * (part * (second + third * per_part - third) - next_slope)
            found[at + 1, k] = keep * found[at, k] + end - keep * begin
            slope[k], chord[k] = next_slope, beyond


@compiled_no_refcount
def add_up(time: Array, table: Array, slopes: Array, areas: Array) -> None:
    """Fill in the slopes of values (n, k) by central differences, and the integral of the values from the first time to
    each time.
    """
    last = len(time) - 1
    for k in range(table.shape[1]):
        slopes[0, k] = (table[1, k] - table[0, k]) / (time[1] - time[0])
    for at in range(last):
        step = time[at + 1] - time[at]
        following = time[at + 2] - time[at + 1] if at + 1 < last else step
        share = following / (step + following)
        for k in range(table.shape[1]):
            chord = (table[at + 1, k] - table[at, k]) / step
            beyond = (table[at + 2, k] - table[at + 1, k]) / following if at + 1 < last else chord
            slopes[at + 1, k] = share * chord + (1.0 - share) * beyond
            bend = step * (slopes[at, k] - slopes[at + 1, k]) / 2.0 / 3.0
            areas[at + 1, k] = areas[at, k] + 0.5 * step * (table[at, k] + table[at + 1, k] + bend)


@compiled_no_refcount
def mean_around(  # noqa: PLR0917 - compiled functions take their parts by position
    time: Array, table: Array, slopes: Array, areas: Array, width: float, rows: Index, found: Array
) -> None:
    """Fill in the result of `averaged` for values (n, k), from the slopes and integrals of `add_up`."""
    last = len(time) - 1
    first = following = 0
    for i in range(len(rows)):
        at = rows[i]
        reach = max(min(0.5 * width, time[at] - time[0], time[last] - time[at]), _AT_ONCE)
        before, after = time[at] - reach, time[at] + reach
        while first < last - 1 and before >= time[first + 1]:
            first += 1
        while following < last - 1 and after >= time[following + 1]:
            following += 1
        for k in range(table.shape[1]):
            until = area(time, table, slopes, areas, following, k, after)
            found[i, k] = (until - area(time, table, slopes, areas, first, k, before)) / (after - before)


@compiled_within
def area(time: Array, table: Array, slopes: Array, areas: Array, at: int, k: int, until: float) -> float:  # noqa: PLR0917 - compiled functions take their parts by position
    """Return the integral of value k from sample `at` to the time `until` after it, of a cubic with the slopes at both
    ends.
    """
    past, step = until - time[at], time[at + 1] - time[at]
    chord, slope, next_slope = (table[at + 1, k] - table[at, k]) / step, slopes[at, k], slopes[at + 1, k]
    square, cube = (3.0 * chord - 2.0 * slope - next_slope) / step, (slope + next_slope - 2.0 * chord) / step**2
    found: float = areas[at, k] + past * (
        table[at, k] + past * (0.5 * slope + past * (square / 3.0 + past * cube / 4.0))
    )
    return found


@compiled_no_refcount
def slide_along(keep: Array, added: Array, found: Array) -> None:
    """Fill in the states (n + 1,) after the first: each is `keep` (n,) times the previous state plus `added` (n,)."""
    for at in range(len(keep)):
        found[at + 1] = keep[at] * found[at] + added[at]
