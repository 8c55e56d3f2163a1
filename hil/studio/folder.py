"""The contents of the folder, as the page shows them: stand files, recordings with their results, and traces."""

from __future__ import annotations

import html
import os
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.acquisition.commissioning import NOTHING_TURNS, announcement
from hil.errors import WrongUse
from hil.recording.reader import Recording
from hil.report.pictures.thinning import trace_rows
from hil.stand.devices import check_backend
from hil.stand.draft import Draft
from hil.stand.file import SIMULATED, Stand, load, parse

_HEAD: Final = 4096  # bytes of a report that hold its title
_TITLE: Final = re.compile(r"<title>[^<]*?: ([^<]*)</title>")
_STANDS: Final = 50  # files that are read
_PAGE: Final = 50  # recordings in one answer
_SUFFIXES: Final = (".h5", ".hdf5", ".part")


class Folder:
    """The folder in which `hil studio` was started; no file outside it is read or written."""

    def __init__(self, place: Path) -> None:
        self.place = place.resolve()

    @property
    def recordings(self) -> Path:
        """The folder for new recordings."""
        return self.place / "recordings"

    def inside(self, name: str) -> Path:
        """Return the path of the file `name`, relative to this folder. Raises WrongUse if the file is not in this
        folder.
        """
        with suppress(OSError, ValueError):
            found = (self.place / name).resolve(strict=True)
            if found.is_file() and found.is_relative_to(self.place):
                return found.relative_to(self.place)
        raise WrongUse(f"{name!r} is no file of this folder any more: it was removed or renamed")

    def stands(self) -> list[dict[str, Any]]:
        """Return the stands of the folder, each with its limits or with what is wrong with its file."""
        files = sorted(self.place.glob("*.toml"))[:_STANDS]
        found = [_described("sim", parse(SIMULATED))]
        for path in files:
            try:
                found.append(_described(path.name, load(path)))
            except (WrongUse, OSError) as error:
                if "[stand]" in path.read_text(encoding="utf-8", errors="replace"):
                    found.append({"file": path.name, "name": path.name, "wrong": str(error)})
        return found

    def listed(self, first: int, wanted: str) -> tuple[list[dict[str, Any]], int]:
        """Return a page of the recordings, newest first, from number `first` on, and how many there are.

        wanted: a text that the name contains, "" for all. Only the recordings of the page are opened; of the others,
        only name and date are read.
        """
        dated = sorted((one for one in self._dated(_SUFFIXES) if wanted.casefold() in one[1].casefold()), reverse=True)
        return [self._entry(name, changed) for changed, name in dated[first : first + _PAGE]], len(dated)

    def _dated(self, suffixes: tuple[str, ...]) -> Iterator[tuple[float, str]]:
        """Yield date and name of each recording in this folder and its direct subfolders."""
        inner = (f"{one.name}/" for one in os.scandir(self.place) if one.is_dir() and one.name[0] != ".")
        for folder in ("", *inner):
            with suppress(OSError):
                for one in os.scandir(self.place / folder):
                    if one.name.endswith(suffixes) and one.name[0] != "." and one.name.isprintable():
                        with suppress(OSError):  # removed since
                            yield one.stat().st_mtime, folder + one.name

    def parts(self) -> list[Path]:
        """Return the recordings that have not ended, newest first."""
        return [self.place / name for _, name in sorted(self._dated((".part",)), reverse=True)]

    def _entry(self, name: str, changed: float) -> dict[str, Any]:
        page = (self.place / name).with_suffix(".html")
        title = _title(page)
        report = page.relative_to(self.place).as_posix() if title else ""
        return {"file": name, "changed": changed, "report": report, "answer": title}


def _described(file: str, stand: Stand) -> dict[str, Any]:
    table = stand.devices.get(str(stand.stand.backend))
    place = next((str(value) for key in ("port", "channel") if (value := getattr(table, key, None))), "")
    return {
        "file": file,
        "name": stand.stand.name,
        "backend": str(stand.stand.backend),
        "place": place,
        "limits": None if stand.limits is None else stand.limits.model_dump(),
        "asked": announcement(stand, "will move with up to {size} at the joint for {time}."),
        "simulated": stand.stand.backend in NOTHING_TURNS,
    }


def questions(backend: str) -> list[dict[str, Any]]:
    """Return the questions of `hil stand new` for a drive, each with its default and its known answers.

    Raises WrongUse.
    """
    draft = Draft(check_backend(backend), None)
    asked = draft.questions()
    return [
        {"key": one.key, "meaning": one.meaning, "default": one.default, "known": draft.answers(one)} for one in asked
    ]


def _title(page: Path) -> str:
    """Return the answer in the title of a report of hil, "" without a title."""
    with suppress(OSError), page.open("rb") as file:
        found = _TITLE.search(file.read(_HEAD).decode("utf-8", errors="replace"))
        return html.unescape(found[1]).strip() if found else ""
    return ""


def is_report(page: Path) -> bool:
    """Return whether `page` exists and is a report of hil, which a later report may replace."""
    return bool(_title(page))


def trace(path: Path) -> bytes:
    """Return the traces of a recording, with the extremes of a long one, as one frame of `Growing.frame`.

    Raises WrongUse and Untrustworthy.
    """
    with Recording(path) as recording:
        time, command, torque, dtheta = (recording.channel(name) for name in ("time", "command", "torque", "dtheta"))
    rows = trace_rows(torque, dtheta)
    known = np.isfinite(time[rows])
    rows = rows[known]
    begin = float(time[rows[0]]) if len(rows) else 0.0
    values = np.array([time[rows] - begin, command[rows], torque[rows], dtheta[rows]], "<f4")
    return struct.pack("<IId", 0, len(rows), begin) + values.tobytes()
