"""The set-points of a run, computed before the motor is armed: in memory, or on disk for a run of many hours."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.recording.output import writing

Array = NDArray[np.float64]

_BLOCK = 512  # set-points read at a time, which takes a small part of a tick
_IN_MEMORY = 1 << 26  # bytes: two hours at 1 kHz, in which the loop does not depend on a disk


class SetPoints:
    """A list of set-points, N m or rad at the joint, that is deleted when it is closed.

    folder: where set-points that do not fit in memory are stored, in a file without a name. Raises WrongUse if the
    folder has no room for them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file = tempfile.SpooledTemporaryFile(_IN_MEMORY, buffering=0, dir=str(folder))  # noqa: SIM115 - closed by __exit__

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def extend(self, values: Array) -> None:
        """Append the set-points `values` (n,). Raises WrongUse if a value is not finite, or the disk is full."""
        if not np.isfinite(values).all():
            raise WrongUse(
                "the profile has a set-point that is not a number, so nothing was driven: correct --setpoints"
            )
        data = values.astype(np.float64).tobytes()
        with writing(self._folder):
            if self._file.write(data) != len(data):
                raise OSError("the disk is full")

    def __iter__(self) -> Iterator[float]:
        self._file.seek(0)
        while data := self._file.read(_BLOCK * 8):
            yield from np.frombuffer(data, dtype=np.float64).tolist()
