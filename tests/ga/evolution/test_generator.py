from __future__ import annotations

import numpy as np
import pytest

from ga.evolution.generator import Words, below, draw, load, seeded, store, uniform


def unsigned(words: Words) -> Words:
    """The words as they are: compiled functions hand them out as whole numbers of Python, which have no size."""
    a, b, c, d = (np.uint64(word) for word in words)
    return a, b, c, d


def test_the_generator_gives_the_published_numbers_of_xoshiro256_plus_plus() -> None:
    state = np.array([1, 2, 3, 4], dtype=np.uint64)
    numbers = []
    for _ in range(10):
        bits, words = draw(unsigned(load(state)))
        store(unsigned(words), state)
        numbers.append(int(bits))
    assert numbers == [
        41943041,
        58720359,
        3588806011781223,
        3591011842654386,
        9228616714210784205,
        9973669472204895162,
        14011001112246962877,
        12406186145184390807,
        15849039046786891736,
        10450023813501588000,
    ]


def test_uniform_numbers_are_the_upper_53_bits_of_a_draw() -> None:
    words = unsigned(load(seeded(7, 3)))
    for _ in range(100):
        bits, _ = draw(unsigned(words))
        number, words = uniform(unsigned(words))
        assert number == (int(bits) >> 11) * 2.0**-53


def test_whole_numbers_below_ten_are_equally_frequent() -> None:
    words, counts = unsigned(load(seeded(0, 0))), np.zeros(11)
    for _ in range(20_000):
        number, words = below(unsigned(words), 10)
        counts[number] += 1
    assert counts[10] == 0
    # chi-square with 9 degrees of freedom: 33.7 is passed by chance once in 10,000 seeds
    assert np.sum((counts[:10] - 2000.0) ** 2 / 2000.0) < 33.7


def test_every_trial_has_its_own_stream_and_the_same_one_each_time() -> None:
    firsts = {int(draw(unsigned(load(seeded(seed, trial))))[0]) for seed in range(20) for trial in range(20)}
    assert len(firsts) == 400
    assert draw(unsigned(load(seeded(5, 2)))) == draw(unsigned(load(seeded(5, 2))))


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="seed -1 is negative"):
        seeded(-1, 0)
