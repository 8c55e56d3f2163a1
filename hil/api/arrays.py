"""Arrays in place of a recording: they are written into a recording of this process, which is read like any other
recording.
"""

from __future__ import annotations

import atexit
import tempfile
from collections.abc import Mapping
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.recording.channels import CHANNELS

_NUMBER = count(1)


def recorded(arrays: Mapping[str, Any], stand: Path | None) -> Path:
    """Return the path of a recording with these arrays, which is removed when the process ends.

    arrays: by channel, numbers in SI or pint quantities, each (n,); None is left out, a NaN is a missing reading.
    Raises WrongUse for a channel that is missing, and for arrays that are no numbers or not of one length.
    """
    from hil.recording.writer import Header, write
    from hil.stand.file import load

    given = {name: _numbers(name, values) for name, values in arrays.items() if values is not None}
    missing = [name for name in ("time", "torque", "dtheta") if name not in given]
    if missing:
        raise WrongUse(f"{' and '.join(missing)} missing: identify needs `time`, `torque` and `dtheta`, or a recording")
    lengths = {name: len(values) for name, values in given.items()}
    if len(set(lengths.values())) > 1:
        said = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise WrongUse(f"the arrays have different lengths ({said}): give one value of each for every sample")
    if lengths["time"] < 2:
        raise WrongUse(f"{lengths['time']} samples determine neither Kc nor Bc: give the arrays of a whole run")
    path = Path(_folder()) / f"arrays{next(_NUMBER)}.h5"
    text = "" if stand is None else load(stand).text
    write(path, Header(profile={"kind": "imported", "source": "arrays"}, stand_toml=text), given)
    return path


def _numbers(name: str, values: Any) -> NDArray[np.float64]:
    """Return the values of a channel as numbers in SI. Raises WrongUse."""
    unit = CHANNELS[name].unit
    if hasattr(values, "magnitude"):
        try:
            values = values.to(unit).magnitude
        except Exception as error:  # noqa: BLE001 - a unit of the caller's own registry
            raise WrongUse(f"{name} cannot be converted to {unit} ({error}): give it in {unit}") from None
    array = np.ma.asarray(values)
    if array.ndim != 1:
        raise WrongUse(f"{name} has the shape {array.shape}: give one value a sample, an array of the shape (n,)")
    try:
        return np.asarray(np.ma.filled(array.astype(np.float64), np.nan))
    except (TypeError, ValueError):
        raise WrongUse(f"{name} holds values that are no numbers: give an array of numbers, in {unit}") from None


@cache
def _folder() -> str:
    folder = tempfile.TemporaryDirectory(prefix="hil-")
    atexit.register(folder.cleanup)
    return folder.name
