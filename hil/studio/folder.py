"""The contents of the folder, as the page shows them: stand files, recordings with their results, and traces."""

from __future__ import annotations

import html
import os
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.acquisition.commissioning import NOTHING_TURNS, announcement
from hil.errors import WrongUse
from hil.hand.file import is_hand
from hil.hand.file import load as load_hand
from hil.recording.input import open_input, read_text
from hil.recording.output import next_free
from hil.recording.posix import in_child
from hil.recording.reader import Recording
from hil.report.pictures.thinning import trace_rows
from hil.stand.devices import check_backend
from hil.stand.draft import Draft
from hil.stand.file import LARGEST, SIMULATED, Stand, load, parse

_HEAD: Final = 4096  # bytes of a report that hold its title
_TITLE: Final = re.compile(r"<title>[^<]*?: ([^<]*)</title>")
_STANDS: Final = 50  # files that are read
_PAGE: Final = 50  # recordings in one answer
_SUFFIXES: Final = (".h5", ".hdf5", ".part")
_JOINT: Final = "#"  # between the name of a hand's file and that of a joint
_TRACE_TIME, _TRACE_MEMORY = 10, 1 << 28  # s of processor time and bytes in which a recording is drawn


class Folder:
    """The folder in which `hil studio` was started; no file outside it is read or written."""

    def __init__(self, place: Path) -> None:
        self.place = place.resolve()

    def next_recording(self) -> Path:
        """Return the name of the next recording, relative to this folder. Raises WrongUse."""
        if (self.place / "recordings").is_symlink():
            raise WrongUse("recordings is a link, and the page writes no file outside its folder: rename the link")
        return next_free(self.place / "recordings").relative_to(self.place)

    def inside(self, name: str) -> Path:
        """Return the path of the file `name`, relative to this folder. Raises WrongUse if there is no regular file of
        that name in this folder: a pipe or a device would block a reader, and a link may lead elsewhere.
        """
        with suppress(OSError, ValueError, RuntimeError):
            found = (self.place / name).resolve(strict=True)
            if found.is_file() and found.is_relative_to(self.place):
                return found.relative_to(self.place)
        raise WrongUse(f"{name!r} is no file of this folder any more: it was removed or renamed")

    def _has(self, name: str) -> bool:
        with suppress(WrongUse):
            return bool(self.inside(name))
        return False

    def stand(self, name: str) -> tuple[Path, str]:
        """Return the stand file and the joint, "" for the only one, of an entry of `stands`. Raises WrongUse."""
        file, _, joint = name.rpartition(_JOINT)
        return (self.inside(file), joint) if file and not self._has(name) else (self.inside(name), "")

    def stands(self) -> list[dict[str, Any]]:
        """Return the stands of the folder, of a hand's file one for each joint, each with its limits or with what is
        wrong with its file.
        """
        found = [_described("sim", parse(SIMULATED))]
        for name in sorted(name for _, name in self._files("", (".toml",)))[:_STANDS]:
            path = self.place / name
            try:
                of_a_hand = is_hand(read_text(path, largest=LARGEST))
                found += _joints(name, path) if of_a_hand else [_described(name, load(path))]
            except (WrongUse, OSError, ValueError) as error:
                if any(table in beginning(path) for table in (b"[stand]", b"[hand]")):
                    found.append({"file": name, "name": name, "wrong": str(error)})
        return found

    def listed(self, first: int, wanted: str) -> tuple[list[dict[str, Any]], int]:
        """Return a page of the recordings, newest first, from number `first` on, and how many there are.

        wanted: a text that the name contains, "" for all. Only the recordings of the page are opened; of the others,
        only name and date are read.
        """
        dated = [one for one in self._dated(_SUFFIXES) if wanted.casefold() in one[1].casefold()]
        return [self._entry(name, changed) for changed, name in dated[first : first + _PAGE]], len(dated)

    def _files(self, folder: str, suffixes: tuple[str, ...]) -> Iterator[tuple[float, str]]:
        """Yield date and name of each regular file with one of the suffixes in a subfolder, "" for this folder.

        Hidden files, and names that a page cannot show, are left out.
        """
        with suppress(OSError):  # no folder, or it may not be read
            for one in os.scandir(self.place / folder):
                name = folder + one.name
                if one.name.endswith(suffixes) and one.name[0] != "." and name.isprintable():
                    with suppress(OSError):  # removed since
                        if one.is_file(follow_symlinks=False) or (one.is_symlink() and self._has(name)):
                            yield one.stat().st_mtime, name

    def _dated(self, suffixes: tuple[str, ...]) -> list[tuple[float, str]]:
        """Return date and name of the recordings in this folder and its direct subfolders, newest first."""
        inner = [f"{one.name}/" for one in os.scandir(self.place) if one.is_dir(follow_symlinks=False)]
        folders = ["", *(one for one in inner if one[0] != ".")]
        return sorted((one for folder in folders for one in self._files(folder, suffixes)), reverse=True)

    def parts(self) -> list[Path]:
        """Return the newest recordings that have not ended, newest first."""
        return [self.place / name for _, name in self._dated((".part",))[:_PAGE]]

    def _entry(self, name: str, changed: float) -> dict[str, Any]:
        page = (self.place / name).with_suffix(".html")
        title = _title(page)
        report = page.relative_to(self.place).as_posix() if title else ""
        return {"file": name, "changed": changed, "report": report, "answer": title}


def _joints(file: str, path: Path) -> list[dict[str, Any]]:
    """Return the stand of each joint of a hand's file, each with the entry of the joint that follows."""
    hand = load_hand(path)
    entries = [f"{file}{_JOINT}{joint.name}" for joint in hand.joints]
    return [
        _described(entry, joint.stand) | {"name": f"{hand.name}: {joint.name}", "next": following}
        for entry, joint, following in zip(entries, hand.joints, [*entries[1:], ""], strict=True)
    ]


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


def beginning(path: Path, size: int = 1 << 16) -> bytes:
    """Return the first bytes of a file, b"" if it cannot be read or is no regular file."""
    with suppress(OSError, WrongUse), open_input(path, largest=1 << 40) as file:
        return file.read(size)
    return b""


def _title(page: Path) -> str:
    """Return the answer in the title of a report of hil, "" without a title."""
    found = _TITLE.search(beginning(page, _HEAD).decode("utf-8", errors="replace"))
    return html.unescape(found[1]).strip() if found else ""


def is_report(page: Path) -> bool:
    """Return whether `page` exists and is a report of hil, which a later report may replace."""
    return bool(_title(page))


def trace(path: Path) -> bytes:
    """Return the traces of a recording, with the extremes of a long one, as one frame of `Growing.frame`.

    Raises WrongUse and Untrustworthy.
    """
    frame = in_child(partial(_frame, path), processor=_TRACE_TIME, memory=_TRACE_MEMORY)
    if frame is None:
        raise WrongUse(
            f"{path.name} is too long to be drawn here, or damaged: `hil identify` reads it, or says why not"
        )
    return frame


def _frame(path: Path) -> bytes:
    with Recording(path) as recording:
        time, command, torque, dtheta = (recording.channel(name) for name in ("time", "command", "torque", "dtheta"))
    rows = trace_rows(torque, dtheta)
    rows = rows[np.isfinite(time[rows])]
    begin = float(time[rows[0]]) if len(rows) else 0.0
    values = np.array([time[rows] - begin, command[rows], torque[rows], dtheta[rows]], "<f4")
    return struct.pack("<IId", 0, len(rows), begin) + values.tobytes()
