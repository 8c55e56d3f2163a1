"""What is known of one drive between two runs: a small file in the user's folder for state."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.servo import ServoInfo
from hil.recording.input import read_text

_LARGEST = 4096  # bytes of a file


class DriveMemory:
    """A file of `kind` for the drive `info`; also: words that tell it from other files of this drive.

    path: `$XDG_STATE_HOME/hil/KIND/DRIVE.json`.
    """

    def __init__(self, kind: str, info: ServoInfo, *also: str) -> None:
        folder = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "hil" / kind
        words = " ".join((info.backend, info.model, info.serial, *also))
        self.path = folder / f"{re.sub(r'[^A-Za-z0-9.-]+', '_', words)}.json"

    def load(self) -> dict[str, Any] | None:
        """Return what was kept, None where nothing was. Raises WrongUse, ValueError where it cannot be read."""
        if not self.path.exists():
            return None
        kept = json.loads(read_text(self.path, largest=_LARGEST))
        if not isinstance(kept, dict):
            raise ValueError("it is no table")
        return kept

    def keep(self, fields: Mapping[str, Any]) -> None:
        """Keep `fields` in place of what was kept. Raises OSError."""
        fresh = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        fresh.write_text(json.dumps(fields, allow_nan=False) + "\n", encoding="ascii")
        fresh.replace(self.path)
