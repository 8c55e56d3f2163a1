"""The recordings that a caller gives: paths, loaded recordings, bytes of files, or data frames."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.api.arrays import is_frame, of_bytes, of_frame
from hil.api.recordings import LoadedRecording
from hil.recording.interval import Given, Part
from hil.recording.reader import Recording
from hil.signals.prepare import Signals, prepare
from hil.signals.source import open_sources

One = str | os.PathLike[str] | LoadedRecording | bytes | Any
"""A recording: its path or content, one that was loaded, or a data frame."""
Recordings = One | Sequence[One]


def several(recordings: Any) -> list[Any]:
    """Return the recordings as a list, also a single one."""
    is_one = isinstance(recordings, str | bytes | os.PathLike | LoadedRecording) or is_frame(recordings)
    return [recordings] if is_one else list(recordings)


def paths(recordings: Recordings, stand: str | os.PathLike[str] | None = None) -> list[Given]:
    """Return the path of each recording; of bytes and frames that of a file of this process. Raises WrongUse.

    stand: the stand file of data frames.
    """
    return [_path(one, None if stand is None else Path(stand)) for one in several(recordings)]


def _path(one: One, stand: Path | None) -> Given:
    if isinstance(one, LoadedRecording):
        return one.path if one.window is None else Part(one.path, *one.window)
    if isinstance(one, bytes):
        return of_bytes(one)
    return of_frame(one, stand) if is_frame(one) else Path(one)


def labels(recordings: Any, given: Given) -> Any:
    """Return a series with the index of a single frame of pandas, from the first row of a part; None for anything
    else.
    """
    all_of_them = [] if recordings is None else several(recordings)
    frame: Any = all_of_them[0] if len(all_of_them) == 1 else None
    if not (is_frame(frame) and hasattr(frame, "index")):
        return None
    with Recording(given) as recording:
        return frame[frame.columns[0]].iloc[recording.first :]


def signals_of(recording: One) -> tuple[Signals, Any]:
    """Return the signals of a recording, and a series with the index of a frame of pandas. Raises WrongUse and
    Untrustworthy.
    """
    [given] = paths(recording)
    with open_sources([given]) as (source,):
        source.verify()
        return prepare(source.recording, source.table), labels(recording, given)
