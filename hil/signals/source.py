"""Open recordings for identification: each file is opened once, and its stand is parsed once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from hil.errors import Untrustworthy
from hil.recording.ahead import Progress
from hil.recording.channels import TorqueScale
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
    def torque_scale(self) -> TorqueScale:
        """Return how well the torque's scale is known: as the stand file states it, otherwise as the drive did."""
        recorded = TorqueScale.stored(self.recording.attributes)
        return recorded if self.stand is None else self.stand.torque_scale(recorded)

    def verify(self, progress: Progress | None = None) -> None:
        """Raise Untrustworthy if the recording has changed since it was written. progress: called with the checked
        fraction.
        """
        recording = self.recording
        if not (recording.header_intact() if recording.live else recording.verify(progress)):
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
