"""Random numbers for the compiled loops: xoshiro256++ (Blackman and Vigna 2019), with one state for each trial.

A state is an array of four unsigned 64-bit words. It is a part of a search's state, so a resumed search continues with
the very next number. In a loop the words are a tuple that each draw takes and returns, so that they stay in the
processor's registers.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_as, compiled_inline, compiled_within

State: TypeAlias = NDArray[np.uint64]
Words: TypeAlias = tuple[np.uint64, np.uint64, np.uint64, np.uint64]

_11, _17, _19, _23, _32, _41, _45 = (np.uint64(shift) for shift in (11, 17, 19, 23, 32, 41, 45))
_TO_UNIT = 2.0**-53
_ALL = 2**64 - 1


def seeded(seed: int, trial: int) -> State:
    """Return the state (4,) of one trial's generator, independent of every other trial's.

    Raises ValueError if the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"seed {seed} is negative: give 0 or more")
    return np.random.SeedSequence(seed, spawn_key=(trial,)).generate_state(4, np.uint64).astype(np.uint64, copy=False)


def uniforms(state: State, count: int) -> NDArray[np.float64]:
    """Return random numbers (count,) in [0, 1), and advance the state (4,). Not compiled: for a few numbers only."""
    found = np.empty(count)
    fill(state, found)
    return found


def fill(state: State, found: NDArray[np.float64]) -> None:
    """Set every number of `found` to a random one in [0, 1), and advance the state (4,)."""
    a, b, c, d = state.tolist()
    for i in range(len(found)):
        total = (a + d) & _ALL
        found[i] = ((((total << 23 | total >> 41) + a) & _ALL) >> 11) * _TO_UNIT
        shifted = b << 17 & _ALL
        c ^= a
        d ^= b
        b ^= c
        a ^= d
        c ^= shifted
        d = (d << 45 | d >> 19) & _ALL
    state[:] = a, b, c, d


@compiled_within
def load(state: State) -> Words:
    """Return a state (4,) as a tuple of words."""
    return state[0], state[1], state[2], state[3]


@compiled_within
def store(words: Words, state: State) -> None:
    """Set a state (4,) to the words."""
    state[0], state[1], state[2], state[3] = words


@compiled_within
def draw(words: Words) -> tuple[np.uint64, Words]:
    """Return the next 64 random bits, and the words after these."""
    a, b, c, d = words
    total = a + d
    bits: np.uint64 = ((total << _23) | (total >> _41)) + a
    shifted = b << _17
    c ^= a
    d ^= b
    b ^= c
    a ^= d
    c ^= shifted
    d = (d << _45) | (d >> _19)
    return bits, (a, b, c, d)


@compiled_inline
def uniform(words: Words) -> tuple[float, Words]:
    """Return a random number in [0, 1), a multiple of 2^-53, and the words after it."""
    bits, words = draw(words)
    return float(bits >> _11) * _TO_UNIT, words


@compiled_as(fill)
def _fill_compiled(state: State, found: NDArray[np.float64]) -> None:
    """Do the same, with the same numbers."""
    words = load(state)
    for i in range(found.size):
        found[i], words = uniform(words)
    store(words, state)


@compiled_inline
def below(words: Words, count: int) -> tuple[int, Words]:
    """Return a random whole number in 0 ... count - 1, and the words after it.

    count: far below 2^32, because without rejection the bias is count / 2^32.
    """
    bits, words = draw(words)
    return np.int64(((bits >> _32) * np.uint64(count)) >> _32), words  # type: ignore[return-value]  # int in numba
