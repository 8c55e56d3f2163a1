"""The set-points of a run, computed before the motor is live and kept on disk: a day's run needs no more memory."""

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


class SetPoints:
    """Set-points in order, N m or rad at the joint, in an unnamed file in `folder`; gone when closed.

    Raises WrongUse where the disk has no room for them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        with writing(folder):
            self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - closed by __exit__

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def extend(self, values: Array) -> None:
        """Add `values` (n,). Raises WrongUse where one is not a number, or the disk is full."""
        if not np.isfinite(values).all():
            raise WrongUse("the profile has a set-point that is not a number: nothing was driven")
        data = values.astype(np.float64).tobytes()
        with writing(self._folder):
            if self._file.write(data) != len(data):
                raise OSError("the disk is full")

    def __iter__(self) -> Iterator[float]:
        self._file.seek(0)
        while data := self._file.read(_BLOCK * 8):
            yield from np.frombuffer(data, dtype=np.float64).tolist()
