"""Save the state of a long run of trials on disk, and resume the run from it.

The file is a NumPy archive (.npz, no pickles), replaced as a whole: a reader gets the old state or the new one. The
file also identifies its run; a run with other data, bounds, settings, seed or number of trials is refused.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import uuid
import zipfile
from dataclasses import asdict
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ga.evolution.population import Population

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from ga.bounds import Bounds
    from ga.evolution.evolution import Settings


_DAMAGED = (ValueError, KeyError, TypeError, AttributeError, EOFError, OverflowError, MemoryError, RuntimeError)
"""The exceptions that NumPy, json and zipfile raise for damaged files; RecursionError and NotImplementedError are
RuntimeErrors.
"""


class WrongCheckpoint(ValueError):
    """The error that a checkpoint cannot be resumed: it is of another run, or is no checkpoint."""


class SearchState(NamedTuple):
    """The population and the record of every trial. A record contains the best fitness, N m, at each point of the
    history.
    """

    populations: list[Population]
    records: NDArray[np.float64]


def belonging(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    *,
    bounds: Bounds,
    settings: Settings,
    seed: int,
    trials: int,
) -> dict[str, str]:
    """Return the texts that identify a run by its data, bounds, settings, seed and number of trials."""
    data = hashlib.sha256(str(columns.shape).encode())
    for array in (columns, torque):
        data.update(np.ascontiguousarray(array).data)
    return {
        "data": data.hexdigest(),
        "bounds": json.dumps([bounds.low.tolist(), bounds.high.tolist()]),
        "settings": json.dumps(asdict(settings), sort_keys=True),
        "seed": str(seed),
        "number of trials": str(trials),
    }


def save(path: Path, belongs: dict[str, str], state: SearchState) -> None:
    """Write the state to `path`, replacing an older file in one step. Raises OSError.

    belongs: the result of `belonging`.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is not an ordinary file", str(path))
    arrays = {
        field: np.stack([getattr(population, field) for population in state.populations])
        for field in Population._fields
    }
    draft = path.with_name(f".hil-{uuid.uuid4().hex}.tmp")
    try:
        with draft.open("xb") as file:
            np.savez(file, records=state.records, belongs=np.array(json.dumps(belongs)), **arrays)  # type: ignore[arg-type]
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def _check_stored(path: Path) -> None:
    """Raise ValueError if a part of the file is damaged, or compressed: unpacking could fill the memory.

    The compiled search uses the orders in the file without checking indices, so a damaged byte must not reach it.
    """
    with zipfile.ZipFile(path) as archive:
        if any(part.compress_type != zipfile.ZIP_STORED for part in archive.infolist()):
            raise ValueError("a part is compressed")
        try:
            whole = archive.testzip() is None
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            whole = False  # a part that is said to begin before the file
        if not whole:
            raise ValueError("a checksum differs")


def load(path: Path, belongs: dict[str, str]) -> SearchState:
    """Return the state in a file. belongs: the result of `belonging` for this run.

    Raises WrongCheckpoint if the file is of another run or no checkpoint, OSError if it cannot be opened.
    """
    if not path.is_file():  # a FIFO or a device would block, or never end
        raise WrongCheckpoint(f"{path} is not an ordinary file: name another")
    try:
        _check_stored(path)
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            found = json.loads(str(archive["belongs"]))
            arrays = [archive[field] for field in Population._fields]
            records = archive["records"]
            differing = [what for what, text in belongs.items() if found.get(what) != text]
            populations = [Population(*parts) for parts in zip(*arrays, strict=True)]
    except (*_DAMAGED, zipfile.BadZipFile) as error:
        raise WrongCheckpoint(
            f"{path} is not a checkpoint of a search, or a damaged one: name another file, or remove it"
        ) from error
    if differing:
        raise WrongCheckpoint(
            f"{path} is the checkpoint of another run, with different {', '.join(differing)}: "
            "run it as it was begun, or remove it to begin anew"
        )
    return SearchState(populations, records)
