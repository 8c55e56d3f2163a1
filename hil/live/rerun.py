"""Show a run in progress, or a recording, as time series in the viewer Rerun (extra `view`) or in a file for that
viewer.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.live.state import State
from hil.recording.output import check_output

Array = NDArray[np.float64]

WINDOW = "window"
_SHOWN = ("command", "torque", "dtheta", "dtheta_dot", "temperature")


def check(place: str, *, force: bool) -> None:
    """Raise WrongUse if Rerun is not installed, or if `place` is neither "window" nor the name of a new file .rrd.

    force: whether an existing file may be replaced.
    """
    _rerun()
    if place == WINDOW:
        return
    if Path(place).suffix != ".rrd":
        raise WrongUse(f"--rerun {place}: write {WINDOW}, or a file that ends in .rrd")
    check_output(Path(place), force=force)


def show(channels: Mapping[str, Array], place: str) -> None:
    """Show a recording's channels in Rerun.

    channels: arrays (n,), SI, by name, including "time". place: "window" or a file .rrd. Raises WrongUse.
    """
    stream = _Columns(place)
    stream.send({name: channels[name] for name in ("time", *_SHOWN) if name in channels})


class Stream:
    """Sends the rows of a run in progress to Rerun. place: "window" or a file .rrd."""

    def __init__(self, place: str) -> None:
        self._columns = _Columns(place)
        self._sent = 0

    def update(self, state: State) -> None:
        """Send the rows that are new since the last call, and the present estimates of Kc and Bc."""
        rows = state.since(self._sent)
        if not len(rows):
            return
        self._sent += len(rows)
        self._columns.send({name: np.array(rows[name]) for name in ("time", *_SHOWN)})
        if state.fit.estimate is not None:
            last = np.array([float(rows["time"][-1])])
            for name, value in zip(("Kc", "Bc"), state.fit.estimate, strict=True):
                self._columns.send({"time": last, f"preliminary/{name}": np.array([value])})


class _Columns:
    def __init__(self, place: str) -> None:
        self._rerun = _rerun()
        self._recording = self._rerun.RecordingStream("hil")
        try:
            if place == WINDOW:
                # the viewer is installed beside Python, which is not on the PATH unless its environment is active
                beside = shutil.which("rerun", path=str(Path(sys.executable).parent))
                self._rerun.spawn(recording=self._recording, executable_path=beside)
            else:
                self._recording.save(place)
        except (RuntimeError, OSError) as error:
            reason = str(error).partition("\n")[0].rstrip(".")  # further lines are commands of its installers
            raise WrongUse(f"--rerun {place}: Rerun cannot show it ({reason}): try a file, such as run.rrd") from None

    def send(self, channels: Mapping[str, Array]) -> None:
        """Send channels (n,), SI, at the times in the channel "time". Values that are not finite are left out."""
        time = channels["time"]
        for name, values in channels.items():
            good = np.isfinite(time) & np.isfinite(values)
            if name == "time" or not good.any():
                continue
            self._rerun.send_columns(
                name,
                indexes=[self._rerun.TimeColumn("time", duration=time[good])],
                columns=self._rerun.Scalars.columns(scalars=values[good]),
                recording=self._recording,
            )
        self._recording.flush()


def _rerun() -> Any:
    try:
        return import_module("rerun")
    except ImportError:
        raise WrongUse("Rerun is not installed, and this needs it: pip install 'hil[view]'") from None
