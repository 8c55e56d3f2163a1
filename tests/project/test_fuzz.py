"""Bytes that nobody meant, fed to every parser of what others wrote: a short form of benchmarks/fuzz.py."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim_backend.wire.catalogue import EMULATORS

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def benchmark(name: str) -> Any:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def parsers() -> Any:
    return benchmark("parsers")


pytestmark = pytest.mark.usefixtures("damaged_files")  # SciPy ends the process on some damaged MAT-files

NAMES = (
    "dynamixel 2", "dynamixel 1, feetech", "feetech block", "mit", "robstride", "moteus", "odrive", "board lines",
    "stand", "plan",
    "faults", "csv", "csv.gz", "mat", "mcap", "weights", "heat", "journal", "result", "checkpoint",
    "quantity", "row filter",
)  # fmt: skip


@pytest.mark.study
def test_every_parser_is_fed(parsers: Any) -> None:
    assert tuple(parsers.PARSERS) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_what_good_bytes_say_is_read(parsers: Any, name: str) -> None:
    for seed in parsers.PARSERS[name].seeds:
        parsers.PARSERS[name].read(seed)


@st.composite
def changed(draw: st.DrawFn, seeds: tuple[bytes, ...], *, is_text: bool) -> bytes:
    """Good bytes that were flipped, cut off, doubled or merged with others; or other bytes altogether."""
    if draw(st.integers(0, 5)) == 0:
        return draw(st.binary(max_size=60))
    data = bytearray(draw(st.sampled_from(seeds)))
    value = st.integers(32, 126) if is_text else st.integers(0, 255)
    for at, new in draw(st.lists(st.tuples(st.integers(0, len(data) - 1), value), max_size=6)):
        data[at] = new
    data = data[: draw(st.integers(0, len(data)))] if draw(st.booleans()) else data
    return bytes(data) + (draw(st.sampled_from(seeds)) if draw(st.integers(0, 3)) == 0 else b"")


@pytest.mark.study
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_changed_bytes_are_read_or_declined_in_a_sentence(parsers: Any, name: str, data: st.DataObject) -> None:
    parser = parsers.PARSERS[name]
    parsers.read(parser, data.draw(changed(parser.seeds, is_text=parser.is_text)))


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("dynamixel")])
@given(data=st.data())
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_reply_with_up_to_three_changed_bits_is_never_taken_for_another(
    parsers: Any, name: str, data: st.DataObject
) -> None:
    parser = parsers.PARSERS[name]
    seed = parser.seeds[0]
    bits = 3 if name == "dynamixel 2" else 1  # the checksum of protocol 1 is a sum of bytes
    flips = data.draw(st.sets(st.integers(0, 8 * len(seed) - 1), min_size=1, max_size=bits))
    reply = bytearray(seed)
    for bit in flips:
        reply[bit // 8] ^= 1 << bit % 8
    answer = parser.read(bytes(reply))
    assert answer is None or answer == parser.read(seed)


@pytest.mark.parametrize("name", sorted(EMULATORS))
def test_no_frame_ends_an_emulator_or_makes_its_plant_infinite(name: str) -> None:
    assert benchmark("emulators").feed(name, 2_000, seed=2000) == 2_000
