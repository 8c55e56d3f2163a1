"""Files of other people: reading one takes memory and time in proportion to its size, whatever is in it."""

from __future__ import annotations

import gzip
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.errors import WrongUse
from hil.recording.input import bounded

pytestmark = pytest.mark.usefixtures("damaged_files")


@pytest.mark.parametrize("work", [lambda: bytearray(1 << 30), os.abort], ids=["memory", "crash"])
def test_what_a_library_does_with_a_file_harms_nobody_else(tmp_path: Path, work: Callable[[], object]) -> None:
    (tmp_path / "a.parquet").write_bytes(b"x")
    with pytest.raises(WrongUse, match="reading it crashes, or takes more than 6 s of processor time or 512 MiB"):
        bounded(tmp_path / "a.parquet", work)


def test_a_table_comes_back_as_it_was_read(tmp_path: Path) -> None:
    (tmp_path / "a.parquet").write_bytes(b"x")
    names, numbers = bounded(tmp_path / "a.parquet", lambda: (["a"], np.arange(1_000_000.0)))
    assert (names, numbers.sum()) == (["a"], 499_999_500_000.0)


def test_a_file_that_unpacks_to_a_hundred_times_its_size_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (
        gzip.open(tmp_path / "a.csv.gz", "wb", 1) as packed,
        zipfile.ZipFile(tmp_path / "a.npz", "w", 8, compresslevel=1) as archive,
    ):
        for number in range(9):
            packed.write(bytes(1 << 23))
            archive.writestr(f"{number}.npy", bytes(1 << 23))
    for name in ("a.csv.gz", "a.npz"):
        with pytest.raises(WrongUse, match=r"unpacks to more than 67.1 MB, as no table of readings does"):
            bounded(tmp_path / name, list)
