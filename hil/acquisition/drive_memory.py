"""Facts about one drive or stand that are kept between runs, in a small file in the user's state folder."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from drivers.ports import emulation
from drivers.servo import ServoInfo
from hil.errors import WrongUse
from hil.recording.input import read_text
from hil.recording.output import atomic_write
from hil.stand.file import Stand

_LARGEST = 4096  # bytes of a file


class StoredFacts:
    """A file that keeps facts of one kind about one drive or stand between runs.

    kind: subject of the facts, and name of their folder. words: the names of the drive or stand. path:
    `$XDG_STATE_HOME/hil/KIND/WORDS.json`. Raises WrongUse if the user has no folder for such files.
    """

    def __init__(self, kind: str, *words: str) -> None:
        self.path = _state_folder() / "hil" / kind / f"{file_name(*words)}.json"

    @classmethod
    def of_drive(cls, kind: str, stand: Stand, info: ServoInfo, *also: str) -> Self:
        """Return the file of facts about the drive `info` of `stand`. also: words that distinguish several files of
        this drive. What an emulator shows does not count for a real drive with its model and id, nor the reverse.
        """
        return cls(kind, info.backend, info.model, info.serial, *also, *emulation_of(stand))

    def load(self) -> dict[str, Any] | None:
        """Return the stored fields, None if nothing was stored. Raises WrongUse or ValueError if the file cannot be
        read.
        """
        try:
            self.path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise WrongUse(f"{self.path} cannot be read ({error.strerror}): change its permissions") from None
        kept = json.loads(read_text(self.path, largest=_LARGEST))
        if not isinstance(kept, dict):
            raise ValueError("it is no table")
        return kept

    def keep(self, fields: Mapping[str, Any]) -> None:
        """Store `fields`; they replace everything stored before. Raises WrongUse."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(self.path, force=True) as fresh:
                fresh.write_text(json.dumps(fields, allow_nan=False) + "\n", encoding="ascii")
        except (OSError, WrongUse) as error:
            reason = getattr(error.__cause__ or error, "strerror", None) or str(error)
            raise WrongUse(
                f"{self.path} cannot be written ({reason}): it stores facts about this drive that the next run needs; "
                "make room, or set XDG_STATE_HOME to a folder that can be written"
            ) from None


def emulation_of(stand: Stand) -> tuple[str, ...]:
    """Return the kind of link by which the drive of `stand` may be an emulator, () for one on real hardware."""
    kind = emulation(stand.devices.get(str(stand.stand.backend)))
    return (f"on {kind}",) if kind else ()


def file_name(*words: str) -> str:
    """Return the words as one name of a file. Every character except letters, digits, "." and "-" becomes "_"."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", " ".join(words))


def _state_folder() -> Path:
    """Return the user's state folder. It does not depend on the working directory: otherwise a run from another
    directory would not know that the motor is hot.
    """
    asked = Path(os.environ.get("XDG_STATE_HOME", ""))
    try:
        folder = asked if asked.is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError:  # an unknown user, as in a container
        folder = asked
    if not folder.is_absolute():
        raise WrongUse(
            "this user has no home folder, in which hil stores the facts about this drive that the next run needs: set "
            "XDG_STATE_HOME to a folder that can be written"
        )
    return folder
