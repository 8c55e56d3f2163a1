"""Open recordings for identification: each file is opened once, and its stand is parsed once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from hil.errors import Untrustworthy
from hil.printable import quoted
from hil.recording.ahead import Progress
from hil.recording.interval import Given
from hil.recording.reader import Recording
from hil.stand.file import LimitsTable, Stand, StandTable, parse


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """An open recording, and the stand that its file contains (None if it contains none)."""

    recording: Recording
    stand: Stand | None

    @property
    def path(self) -> Path:
        """Return the recording's file."""
        return self.recording.path

    @property
    def table(self) -> StandTable | None:
        """Return the stand file's [stand] table, None if there is none."""
        return None if self.stand is None else self.stand.stand

    @property
    def limits(self) -> LimitsTable | None:
        """Return the stand file's [limits] table, None if there is none."""
        return None if self.stand is None else self.stand.limits

    @property
    def torque_uncertainty(self) -> float:
        """Return the relative standard uncertainty of the torque's scale; 0 if no stand gives one."""
        return 0.0 if self.table is None else self.table.torque_uncertainty

    def verify(self, progress: Progress | None = None) -> None:
        """Raise Untrustworthy if the recording has changed since it was written. progress: called with the checked
        fraction.
        """
        if self.recording.damaged:
            raise Untrustworthy(
                f"{self.path}: {self.recording.damaged} rows are not the ones that were written: make a recording in "
                f"which they count as lost with `hil recover {quoted(self.path)}`"
            )
        if not self.recording.verify(progress):
            raise Untrustworthy(
                f"{self.path} is not as it was written (its SHA-256 differs), so Kc and Bc cannot be identified from "
                "it: use another copy of the file, or record again"
            )


@contextmanager
def open_sources(given: Sequence[Given]) -> Iterator[list[Source]]:
    """Open recordings or parts of them. Raises WrongUse, and Untrustworthy for a damaged recording."""
    with ExitStack() as stack:
        sources = []
        for one in given:
            recording = stack.enter_context(Recording(one))
            text = recording.stand_toml
            sources.append(Source(recording, parse(text, f"{recording.path}: stand_toml") if text else None))
        yield sources
