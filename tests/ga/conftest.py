"""Recordings of known making for the tests of the search."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import pytest

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Data(NamedTuple):
    """columns (n, p), torque (n,) and the genes (p,) they were made with."""

    columns: NDArray[np.float64]
    torque: NDArray[np.float64]
    truth: NDArray[np.float64]


class Making(Protocol):
    """How a recording of p <= 8 columns is made."""

    def __call__(self, truth: list[float], *, noise: float, count: int, seed: int) -> Data: ...


def _made(truth: list[float], *, noise: float, count: int, seed: int) -> Data:
    """A chirp through up to eight columns, some of them strongly correlated, with normal noise (N m)."""
    rng = np.random.default_rng(seed)
    time = np.arange(count) / 500
    dtheta = 0.3 * np.sin(2 * np.pi * (0.2 + 0.5 * time) * time) + 0.1 * np.sin(2 * np.pi * 0.31 * time)
    rate = np.gradient(dtheta, time)
    every = [dtheta, rate, np.ones(count), np.tanh(rate / 0.05), dtheta**3, time, np.gradient(rate, time), dtheta**5]
    columns = np.stack(every[: len(truth)], axis=1)
    return Data(columns, columns @ truth + rng.normal(scale=noise, size=count), np.array(truth))


@pytest.fixture
def made() -> Making:
    """Makes a recording from its genes."""
    return _made


@pytest.fixture
def paper_like() -> Data:
    """The paper's joint: 2,500 samples, 17.75 mN m/rad and 0.19 mN m s/rad, with 0.2 mN m of noise."""
    return _made([17.75e-3, 0.19e-3], noise=2e-4, count=2500, seed=0)
