"""The origin of a result: its recordings, their stand and drive, when they were made, and with which program."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hil.errors import Untrustworthy, WrongUse
from hil.recording.reader import Recording
from hil.stand.file import parse


def provenance(recordings: Sequence[Path], command: str) -> list[tuple[str, str]]:
    """Return the origin of a result as pairs of a name and a text. command: the command line, "" if there was none.

    For a recording that cannot be read any more, the text is the reason.
    """
    rows = [pair for path in recordings for pair in _of_recording(path)]
    made = [("report made", f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC"), ("by", _hil())]
    return [*rows, *made, *([("command", command)] if command else [])]


def _hil() -> str:
    try:
        return f"hil {version('hil')}"
    except PackageNotFoundError:  # a checkout that is run without being installed has none
        return "hil, not installed"


def _of_recording(path: Path) -> list[tuple[str, str]]:
    try:
        with Recording(path) as recording:
            said, text, profile = recording.attributes, recording.stand_toml, recording.profile
            samples = len(recording)
    except (WrongUse, Untrustworthy) as error:
        return [("recording", str(path)), ("its state", str(error))]
    rows = {
        "recording": str(path),
        "recorded": str(said.get("created", "")),
        "excitation": f"{profile.get('kind', 'unknown')}, {samples} samples",
        "stand": _stand(text),
        "calibrated": _calibrations(text),
        "recorded by": _software(str(said.get("software", ""))),
        "recorded with": str(said.get("command_line", "")),
        "note": str(said.get("operator_note", "")),
        "SHA-256 of the samples": str(said.get("sha256", "")),
    }
    return [(name, value) for name, value in rows.items() if value]


def _stand(text: str) -> str:
    with suppress(tomllib.TOMLDecodeError):
        table = tomllib.loads(text).get("stand", {})
        return ", ".join(f"{table[key]}" for key in ("name", "backend") if key in table)
    return ""


def _calibrations(text: str) -> str:
    """Return the calibrations in the stand file `text` of a recording, each with its date."""
    with suppress(WrongUse):
        made = parse(text).calibration.made() if text else {}
        return ", ".join(f"{name} {date:%Y-%m-%d}" for name, date in made.items())
    return ""


def _software(text: str) -> str:
    with suppress(ValueError):
        table = json.loads(text)
        if isinstance(table, dict):
            return ", ".join(f"{name} {value}" for name, value in table.items() if name != "os")
    return ""
