"""A recording in memory: its channels as arrays with units, as pandas or xarray objects, and as a picture."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.api.wording import worded
from hil.errors import WrongUse
from hil.recording.channels import CHANNELS, units_of
from hil.recording.interval import Part, named
from hil.recording.reader import Event, Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LoadedRecording:
    """A recording in memory. `len(recording)` is the number of samples, `recording["torque"]` is one channel, (n,) in
    SI.

    channels, units, descriptions: by the channel names in `hil.recording.channels`; a missing
    reading is masked (and NaN below the mask), so that statistics leave it out. profile:
    the excitation. attributes: those of the file, such as created and stand_toml. events: of the run, in order. truth:
    the simulator's true parameters, SI; {} for a real stand. complete: whether the run ended as planned.
    window: the first and the last time, s, if only a part was loaded.
    """

    path: Path
    channels: Mapping[str, Array]
    units: Mapping[str, str]
    descriptions: Mapping[str, str]
    profile: Mapping[str, Any]
    attributes: Mapping[str, Any]
    events: tuple[Event, ...]
    truth: Mapping[str, float]
    complete: bool
    window: tuple[float, float] | None = None

    def __getitem__(self, name: str) -> Array:
        try:
            return self.channels[name]
        except KeyError:
            raise KeyError(f"no channel {name!r}; there are {', '.join(self.channels)}") from None

    def __len__(self) -> int:
        return len(self.channels["time"])

    def __repr__(self) -> str:
        return (
            f"<recording {named(self.path, self.window)}: {len(self)} samples, {self.profile.get('kind', 'unknown')}>"
        )

    @property
    def filled(self) -> dict[str, Array]:
        """The channels as ordinary arrays, in which a missing reading is NaN."""
        return {name: np.ma.filled(values, np.nan) for name, values in self.channels.items()}

    def to_pandas(self) -> Any:
        """Return a pandas.DataFrame with time, s, as index and one column for each channel; `attrs["units"]` has the
        units.

        Raises WrongUse if pandas is not installed.
        """
        columns = {name: values for name, values in self.filled.items() if name != "time"}
        pandas = _optional("pandas")
        frame = pandas.DataFrame(columns, index=pandas.Index(self.filled["time"], name="time"))
        frame.attrs["units"] = dict(self.units)
        return frame

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset with time, s, as coordinate; the `attrs` of each variable have its unit and
        description.

        Raises WrongUse if xarray is not installed.
        """
        variables = {
            name: ("time", values, {"units": self.units[name], "long_name": self.descriptions[name]})
            for name, values in self.filled.items()
        }
        time = {"time": variables.pop("time")}
        attributes = {name: self.attributes[name] for name in ("uid", "created", "schema") if name in self.attributes}
        return _optional("xarray").Dataset(variables, time, attributes)

    def plot(self) -> Figure:
        """Return a figure: command, torque and deflection over time, and torque over deflection."""
        from hil.report.pictures.recording import recording_figure

        return recording_figure(self.filled, self.units)


@worded
def load(path: str | os.PathLike[str], *, start: Any = None, end: Any = None) -> LoadedRecording:
    """Return a recording, or its rows from `start` to `end`, with all its channels in memory.

    start, end: times of the recording: numbers, s, pint quantities, or texts such as "2 min"; None: no bound. Raises
    WrongUse for a file that is no recording and if no row is left, Untrustworthy for a damaged one.
    """
    with Recording(Part(Path(path), start, end)) as recording:
        return LoadedRecording(
            path=recording.path,
            channels=MappingProxyType({name: np.ma.masked_invalid(recording.channel(name)) for name in CHANNELS}),
            units=MappingProxyType(units_of(recording.profile.get("mode", "torque"))),
            descriptions=MappingProxyType({name: channel.description for name, channel in CHANNELS.items()}),
            profile=MappingProxyType(recording.profile),
            attributes=MappingProxyType(recording.attributes),
            events=tuple(recording.events()),
            truth=MappingProxyType(recording.truth()),
            complete=recording.complete,
            window=recording.window,
        )


def _optional(package: str) -> Any:
    try:
        return import_module(package)
    except ImportError:
        raise WrongUse(f"{package} is not installed, and this needs it: pip install {package}") from None
