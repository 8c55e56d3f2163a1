"""Columns and torque on disk, for recordings that do not fit in memory: worked out once, gone through many times."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hil.recording.output import check_space, writing

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Told what is being done, in a word or three, and the part of it that is done, 0 to 1."""

_ROWS = 1 << 18  # rows read at a time


class Spool:
    """A table of rows (columns, torque), in SI, in an unnamed file beside `beside`; gone when closed.

    progress is told how far each going through is. Raises WrongUse where the disk has no room for `rows` rows of
    `width` columns.
    """

    def __init__(self, beside: Path, rows: int, width: int, progress: Progress | None = None) -> None:
        self._width = width + 1
        self._progress = progress
        check_space(beside, rows * self._width * 8)
        with writing(beside):
            self._file = tempfile.TemporaryFile(dir=beside.parent, buffering=0)  # noqa: SIM115 - closed by close()
        self.rows = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def extend(self, columns: Array, torque: Array) -> None:
        """Add rows: columns (m, p), torque (m,) N m. Raises WrongUse where the disk is full."""
        table = np.column_stack([columns, torque])
        with writing(Path(str(self._file.name))):
            self._file.write(table.tobytes())
        self.rows += len(table)

    def blocks(
        self, keep: Callable[[NDArray[np.int64]], NDArray[np.bool_]] | None = None
    ) -> Iterable[tuple[Array, Array]]:
        """The rows in order: columns (m, p), torque (m,), of those whose numbers (m,) `keep` says are kept."""
        for start in range(0, self.rows, _ROWS):
            count = min(_ROWS, self.rows - start)
            self._file.seek(start * self._width * 8)
            table = np.frombuffer(self._file.read(count * self._width * 8), dtype=np.float64).reshape(
                count, self._width
            )
            if keep is not None:
                table = table[keep(np.arange(start, start + count))]
            yield np.ascontiguousarray(table[:, :-1]), np.ascontiguousarray(table[:, -1])
            if self._progress is not None:
                self._progress("going through the samples", (start + count) / self.rows)
