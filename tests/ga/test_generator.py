from __future__ import annotations

import numpy as np
import pytest

from ga.generator import below, draw, seeded, uniform


def test_the_generator_gives_the_published_numbers_of_xoshiro256_plus_plus() -> None:
    state = np.array([1, 2, 3, 4], dtype=np.uint64)
    assert [int(draw(state)) for _ in range(10)] == [
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
    one, other = seeded(7, 3), seeded(7, 3)
    for _ in range(100):
        assert uniform(one) == (int(draw(other)) >> 11) * 2.0**-53


def test_whole_numbers_below_ten_are_equally_frequent() -> None:
    state = seeded(0, 0)
    counts = np.bincount([below(state, 10) for _ in range(20_000)], minlength=11)
    assert counts[10] == 0
    # chi-square with 9 degrees of freedom: 33.7 is passed by chance once in 10,000 seeds
    assert np.sum((counts[:10] - 2000.0) ** 2 / 2000.0) < 33.7


def test_every_trial_has_its_own_stream_and_the_same_one_each_time() -> None:
    firsts = {int(draw(seeded(seed, trial))) for seed in range(20) for trial in range(20)}
    assert len(firsts) == 400
    assert int(draw(seeded(5, 2))) == int(draw(seeded(5, 2)))


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="seed -1 is negative"):
        seeded(-1, 0)
