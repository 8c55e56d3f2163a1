"""Columns and torque on disk, for recordings that do not fit in memory: computed once, read many times."""

from __future__ import annotations

import errno
import os
import tempfile
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, Self

import numpy as np

from ga.arrays import Array
from hil.identification.fitting.blocks import Block, Blocks
from hil.recording.ahead import Progress, ahead
from hil.recording.output import check_space, writing
from hil.signals import constants as c

_BYTES: Final = np.dtype(np.float64).itemsize  # of a value in the file


class DiskTable:
    """A table of rows of columns and torque, SI, in an unnamed file in the folder of `beside`; closing deletes the
    file.

    progress: a function that is called during each pass. Raises WrongUse if the disk has no room for `rows` rows of
    `width` columns.
    """

    def __init__(self, beside: Path, rows: int, width: int, progress: Progress | None = None) -> None:
        self._width = width
        self._torque = rows * width  # where it begins: behind the columns, so that a block of either is read as it is
        self._progress = progress
        check_space(beside, rows * (width + 1) * _BYTES)
        with writing(beside):
            self._file = tempfile.TemporaryFile(dir=beside.parent, buffering=0)  # noqa: SIM115 - closed by __exit__
        self._one_reader = threading.Lock()
        self.rows = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def extend(self, columns: Array, torque: Array) -> None:
        """Add rows: columns (m, p), torque (m,) N m. Raises WrongUse if the disk is full."""
        with writing(Path(str(self._file.name))):
            self._write(columns, self.rows * self._width)
            self._write(torque, self._torque + self.rows)
        self.rows += len(torque)

    def _write(self, values: Array, at: int) -> None:
        self._file.seek(_BYTES * at)
        if self._file.write(np.ascontiguousarray(values).data) != values.nbytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    @property
    def blocks(self) -> Blocks:
        """Return the rows written so far, in order."""
        return Blocks(self.rows, self._read)

    def _read(self) -> Iterable[Block]:
        done = 0
        for columns, torque in ahead(self._stored()):
            yield columns, torque
            done += len(torque)
            if self._progress is not None:
                self._progress("reading the samples again", done / self.rows)

    def _stored(self) -> Iterator[Block]:
        for start in range(0, self.rows, c.TABLE_ROWS):
            count = min(c.TABLE_ROWS, self.rows - start)
            columns, torque = np.empty((count, self._width)), np.empty(count)
            with self._one_reader:
                self._fill(columns, start * self._width)
                self._fill(torque, self._torque + start)
            yield columns, torque

    def _fill(self, values: Array, at: int) -> None:
        self._file.seek(_BYTES * at)
        self._file.readinto(values.data)
