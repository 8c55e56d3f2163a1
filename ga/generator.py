"""Random numbers for the compiled loops: xoshiro256++ (Blackman and Vigna 2019), one state for each trial.

The state is an array of four unsigned 64-bit words that the functions advance in place. It is part of a search's
state, so a search that is cut short goes on with the very next number.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled

State: TypeAlias = NDArray[np.uint64]

_11, _17, _19, _23, _32, _41, _45 = (np.uint64(shift) for shift in (11, 17, 19, 23, 32, 41, 45))
_TO_UNIT = 2.0**-53


def seeded(seed: int, trial: int) -> State:
    """The state (4,) of one trial's generator, independent of every other trial's.

    Raises ValueError where the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"seed {seed} is negative: give 0 or more")
    return np.random.SeedSequence(seed, spawn_key=(trial,)).generate_state(4, np.uint64).astype(np.uint64, copy=False)


@compiled
def draw(state: State) -> np.uint64:
    """The next 64 random bits."""
    total = state[0] + state[3]
    bits: np.uint64 = ((total << _23) | (total >> _41)) + state[0]
    shifted = state[1] << _17
    state[2] ^= state[0]
    state[3] ^= state[1]
    state[1] ^= state[2]
    state[0] ^= state[3]
    state[2] ^= shifted
    state[3] = (state[3] << _45) | (state[3] >> _19)
    return bits


@compiled
def uniform(state: State) -> float:
    """A number in [0, 1), a multiple of 2^-53."""
    return float(draw(state) >> _11) * _TO_UNIT


@compiled
def below(state: State, count: int) -> int:
    """A whole number in 0 ... count - 1, for counts far below 2^32 (no rejection: the bias is count / 2^32)."""
    return np.int64(((draw(state) >> _32) * np.uint64(count)) >> _32)  # type: ignore[return-value]  # int in numba
