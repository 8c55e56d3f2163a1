"""Arrays, data frames and bytes in place of a recording: they are written into a recording of this process, which is
read like any other recording.
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

from hil import units
from hil.errors import WrongUse
from hil.exchange.headings import listed, names, unit_of
from hil.recording.channels import CHANNELS
from hil.recording.interval import Given, path_of

_NUMBER = count(1)
_DIMENSIONS = {"s": "time", "N*m": "torque", "rad": "angle", "rad/s": "rate"}


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
    path = _new("arrays")
    text = "" if stand is None else load(stand).text
    write(path, Header(profile={"kind": "imported", "source": "arrays"}, stand_toml=text), given)
    return path


def of_bytes(content: bytes) -> Path:
    """Return the path of a file with the content of a recording, which is removed when the process ends."""
    path = _new("bytes")
    path.write_bytes(content)
    return path


def content_of(given: Given) -> bytes | None:
    """Return the content of a file of this process; None for the path of a caller, which others may read too."""
    path = path_of(given)
    return path.read_bytes() if path.parent == Path(_folder()) else None


def is_frame(value: Any) -> bool:
    """Return whether a value is a data frame, such as those of pandas and polars. Raises WrongUse for a frame whose
    values are still to be computed.
    """
    if not isinstance(value, list | tuple) and any(hasattr(value, one) for one in ("collect", "compute")):
        name = "collect" if hasattr(value, "collect") else "compute"
        raise WrongUse(f"a {type(value).__name__} has no values yet: pass frame.{name}()")
    return hasattr(value, "columns") and hasattr(value, "__getitem__") and hasattr(value, "shape")


def of_frame(frame: Any, stand: Path | None) -> Path:
    """Return the path of a recording with the columns of a data frame that are named as channels are.

    A column's unit is that in `attrs["units"]`, or in its heading ("torque [mN*m]", "time_ms"), else SI. The index is
    the time if it is named so, or if it holds dates. Raises WrongUse.
    """
    stated = dict(getattr(frame, "attrs", {}).get("units", {}))
    series = {str(title): frame[title] for title in frame.columns}
    index = getattr(frame, "index", None)
    if index is not None and (index.name is not None or index.dtype.kind in "mM"):
        series = {str(index.name or "time"): index, **series}
    found: dict[str, Any] = {}
    for channel in CHANNELS:
        titles = [title for title in series if channel in {name.lower() for name in (title, *names(title))}]
        if len(titles) > 1:
            raise WrongUse(f"the columns {listed(titles)} are all {channel}: keep one of them")
        for title in titles if channel != "seq" else ():
            found[channel] = _in_si(channel, title, series[title], stated.get(title))
    if missing := [name for name in ("time", "torque", "dtheta") if name not in found]:
        raise WrongUse(
            f"the data frame has no column {' and none '.join(missing)}; it has {listed(list(series))}. Rename columns "
            "to time, torque and dtheta (motor angle / gear ratio - joint angle), with units as in 'torque [mN*m]'; or "
            "pass arrays: hil.identify(time=..., torque=..., dtheta=...)"
        )
    return recorded(found, stand)


def _in_si(channel: str, title: str, series: Any, stated: str | None) -> NDArray[np.float64]:
    """Return the values of a column in SI. Raises WrongUse."""
    is_date = getattr(getattr(series, "dtype", None), "kind", "") == "M"  # pandas: also with a time zone
    values = np.asarray(series.to_numpy(dtype="datetime64[ns]") if is_date else series.to_numpy())
    if values.dtype.kind in "mM" and values.size:
        passed = values - np.fmin.reduce(values) if values.dtype.kind == "M" else values
        return np.asarray(passed / np.timedelta64(1, "s"), np.float64)
    if values.dtype == object and hasattr(series, "isna"):
        values = np.where(series.isna(), np.nan, values)  # pandas.NA is no number
    numbers = _numbers(channel, values)
    if channel == "status":
        return np.nan_to_num(numbers)
    dimension = _DIMENSIONS.get(CHANNELS[channel].unit)
    unit = dimension and (stated or unit_of(title, dimension))
    return numbers * units.factor(dimension, unit) if dimension and unit else numbers


def _new(kind: str) -> Path:
    return Path(_folder()) / f"{kind}{next(_NUMBER)}.h5"


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
