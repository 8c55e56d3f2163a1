"""MATLAB's files, against SciPy's reading of what SciPy wrote; and damaged ones, which end in a sentence."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import loadmat, savemat

from hil.errors import WrongUse
from hil.exchange.matlab import vectors

VARIABLES: dict[str, Any] = {
    "double": np.linspace(-1.0, 1.0, 7),
    "column": np.array([[1.5], [2.5], [3.5]]),
    "single": np.array([0.5, 0.25], dtype=np.float32),
    **{f"of_{kind}": np.array([0, 1, 100], dtype=kind) for kind in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")},
    "a_name_that_does_not_fit_into_the_four_bytes": np.arange(3.0),
    "s": np.array([9.0]),
    "none": np.zeros((0, 0)),
    "matrix": np.eye(3),
    "complex": np.array([1.0 + 2.0j, 3.0]),
    "text": "what was done",
    "log": {"t": np.arange(5.0), "q": np.arange(5, dtype=np.int16), "note": "x", "deeper": {"a": np.arange(2.0)}},
    "cells": np.array([np.arange(2.0), "a"], dtype=object),
}


def written(*, compressed: bool) -> bytes:
    buffer = io.BytesIO()
    savemat(buffer, VARIABLES, do_compression=compressed)
    return buffer.getvalue()


@pytest.mark.parametrize("compressed", [False, True])
def test_vectors_are_what_scipy_reads(tmp_path: Path, *, compressed: bool) -> None:
    path = tmp_path / "a.mat"
    path.write_bytes(written(compressed=compressed))
    expected = loadmat(path)
    found = vectors(path)
    for name in ("double", "column", "single", "of_i1", "of_u8", "s", "a_name_that_does_not_fit_into_the_four_bytes"):
        np.testing.assert_array_equal(found.pop(name), expected[name].ravel())
    np.testing.assert_array_equal(found.pop("log.t"), np.arange(5.0))
    np.testing.assert_array_equal(found.pop("log.q"), np.arange(5.0))
    assert set(found) == {f"of_{kind}" for kind in ("u1", "i2", "u2", "i4", "u4", "i8")}


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_off_anywhere_is_refused_or_has_what_came_before(tmp_path: Path, *, compressed: bool) -> None:
    whole, path = written(compressed=compressed), tmp_path / "a.mat"
    path.write_bytes(whole)
    complete = vectors(path)
    refused = 0
    for length in range(0, len(whole), 37):
        path.write_bytes(whole[:length])
        try:
            found = vectors(path)
        except WrongUse:
            refused += 1
        else:
            assert found.keys() <= complete.keys()
            assert all(np.array_equal(values, complete[name]) for name, values in found.items())
    assert refused > 0.8 * len(whole) / 37


@given(
    data=st.one_of(
        st.builds(
            lambda whole, at, junk: whole[: at % len(whole)] + junk + whole[at % len(whole) + len(junk) :],
            st.sampled_from([written(compressed=False), written(compressed=True)]),
            st.integers(0, 10**6),
            st.binary(min_size=1, max_size=16),
        ),
        st.binary(max_size=300).map(lambda rest: written(compressed=False)[:128] + rest),
    )
)
def test_a_damaged_file_is_read_or_refused_and_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.mat"
    path.write_bytes(data)
    try:
        found = vectors(path)
    except WrongUse as error:
        assert "MAT" in str(error)  # noqa: PT017 - either outcome is right
    else:
        assert all(values.ndim == 1 for values in found.values())


def test_an_element_that_would_fill_the_memory_is_refused(tmp_path: Path) -> None:
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(200)) + packer.flush()
    data = written(compressed=False)[:128] + struct.pack("<II", 15, len(packed)) + packed
    path = tmp_path / "bomb.mat"
    path.write_bytes(data)
    with pytest.raises(WrongUse, match="unpack to more than"):
        vectors(path)


def test_a_struct_without_a_length_of_its_names_is_damaged(tmp_path: Path) -> None:
    parts = struct.pack("<IIII", 6, 8, 2, 0) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 0)
    parts += struct.pack("<II", 5, 0) + struct.pack("<II", 1, 0)
    place = tmp_path / "a.mat"
    place.write_bytes(b"MATLAB 5.0".ljust(126) + b"IM" + struct.pack("<II", 14, len(parts)) + parts)
    with pytest.raises(WrongUse, match="damaged MAT-file"):
        vectors(place)
