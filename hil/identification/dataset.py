"""From recordings to what the search takes: the signals in memory where they fit, columns on disk where they do not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.diagnostics import Diagnostic, driven_by_position
from hil.errors import Untrustworthy
from hil.identification.disk_table import Progress, Spool
from hil.identification.model_choice import Choice
from hil.recording.reader import Recording
from hil.signals.prepare import Signals, glimpse, joined, prepare, stream
from hil.signals.quality import assess
from hil.stand.file import StandTable, parse

Array = NDArray[np.float64]
Keep = Callable[[NDArray[np.int64]], NDArray[np.bool_]]
Choose = Callable[[Signals, bool], Choice]
Table = Callable[[Keep | None], Iterable[tuple[Array, Array]]]
"""Columns (m, p) and torque (m,) N m of all rows in order, of those whose numbers `Keep` says are kept."""

IN_MEMORY = 4_000_000
"""Rows, of all recordings together, up to which they are held in memory."""


@dataclass(frozen=True, slots=True)
class Dataset:
    """The recordings, pooled.

    choice: the model, anchored to them, and why. signals: all of them, or stretches of larger ones. told: which of the
    signals the model says something about. samples: how many of all that are. whole: whether the signals are all.
    uncertainty: of the torque's scale, relative, one standard deviation. edges: where each recording ends, in samples.
    diagnostics: what is to be said of them.
    """

    choice: Choice
    signals: Signals
    told: NDArray[np.bool_]
    samples: int
    whole: bool
    uncertainty: float
    edges: tuple[int, ...]
    diagnostics: list[Diagnostic]
    _table: Table

    def blocks(self, keep: Keep | None = None) -> Iterable[tuple[Array, Array]]:
        """Columns and torque of all samples in order, of those whose numbers (m,) `keep` says are kept.

        Of a model that is not linear in its parameters, those of its shape left at zero.
        """
        return self._table(keep)


@contextmanager
def open_dataset(paths: list[Path], choose: Choose, progress: Progress | None = None) -> Iterator[Dataset]:
    """The recordings at `paths` with the model that `choose` says, from signals and whether they are all of them.

    progress is told of every going through recordings that do not fit in memory. Raises WrongUse, Untrustworthy as
    reading and `prepare` do.
    """
    rows = _rows(paths)
    if rows <= IN_MEMORY:
        yield _in_memory(paths, choose)
        return
    signals = _glimpsed(paths)
    choice = choose(signals, False)
    with Spool(paths[0], rows, len(choice.model.linear), progress) as spool:
        edges, diagnostics = _spooled(paths, choice, spool, rows, progress)
        uncertainty = max(torque_uncertainty(path) for path in paths)
        told = choice.told(signals.motion)
        yield Dataset(choice, signals, told, spool.rows, False, uncertainty, edges, diagnostics, spool.blocks)


def table(columns: Array, torque: Array) -> Table:
    """Columns (n, p) and torque (n,) as `Dataset.blocks` gives them."""

    def blocks(keep: Keep | None) -> Iterable[tuple[Array, Array]]:
        chosen = slice(None) if keep is None else keep(np.arange(len(torque)))
        return [(columns[chosen], torque[chosen])]

    return blocks


def _rows(paths: list[Path]) -> int:
    total = 0
    for path in paths:
        with Recording(path) as recording:
            total += len(recording)
    return total


def stand_of(recording: Recording) -> StandTable | None:
    """The stand that a recording was made on, None where the file names none. Raises WrongUse for a damaged one."""
    text = recording.stand_toml
    return parse(text, f"{recording.path}: stand_toml").stand if text else None


def torque_uncertainty(path: Path) -> float:
    """Of the torque's scale, relative, one standard deviation, as the stand of a recording says; 0 without one."""
    with Recording(path) as recording:
        stand = stand_of(recording)
    return 0.0 if stand is None else stand.torque_uncertainty


def recording_diagnostics(recording: Recording, signals: Signals) -> list[Diagnostic]:
    """What any use of a recording must say of it: that it did not end, what was dropped, what was mended."""
    found = []
    if not recording.complete:
        why = str(recording.attributes.get("end_reason", "")) or "it never ended"
        found.append(
            Diagnostic("unfinished", f"{recording.path} is not a whole run ({why}): its {len(recording)} rows are used")
        )
    if signals.lost:
        lost = f"{signals.lost} of {len(recording)} replies were lost and are left out: hil doctor shows how often"
        found.append(Diagnostic("lost-samples", lost))
    if signals.not_numbers:
        found.append(
            Diagnostic(
                "not-a-number",
                f"{signals.not_numbers} of {len(recording)} rows hold a NaN and are left out: hil export shows which",
            )
        )
    if signals.near_gaps:
        gaps = f"{signals.near_gaps} rows lie beside a gap, where no rate can be told: record without a pause"
        found.append(Diagnostic("near-gaps", gaps))
    if signals.coarse_clock:
        found.append(
            Diagnostic(
                "coarse-clock",
                "several rows share a time stamp: they were spread evenly up to the next stamp; a finer clock tells Bc "
                "better",
            )
        )
    if signals.torque_from == "motor" and recording.profile.get("mode") == "position":
        found.append(driven_by_position(is_error=True))
    return found


def _in_memory(paths: list[Path], choose: Choose) -> Dataset:
    parts, diagnostics = [], []
    for path in paths:
        with Recording(path) as recording:
            if not recording.verify():
                raise Untrustworthy(f"{path}: the samples are not the ones that were written (sha256 differs)")
            parts.append(prepare(recording, stand_of(recording)))
            diagnostics += recording_diagnostics(recording, parts[-1]) + assess(recording, parts[-1]).diagnostics()
    signals = joined(parts)
    choice = choose(signals, True)
    told, motion = choice.told(signals.motion), signals.motion
    columns, torque = choice.model.columns(motion)[told], choice.model.target(motion, signals.torque)[told]
    uncertainty = max(torque_uncertainty(path) for path in paths)
    edges = tuple(np.cumsum(told)[np.cumsum([len(part) for part in parts]) - 1].tolist())
    diagnostics += _slow(len(told) - len(torque), len(told))
    return Dataset(choice, signals, told, len(torque), True, uncertainty, edges, diagnostics, table(columns, torque))


def _slow(left_out: int, samples: int) -> list[Diagnostic]:
    if not left_out:
        return []
    text = f"{left_out} of {samples} samples, so slow that friction may hold the joint, are left out: drive faster"
    return [Diagnostic("slow-samples", text)]


def _glimpsed(paths: list[Path]) -> Signals:
    parts = []
    for path in paths:
        with Recording(path) as recording:
            parts.append(glimpse(recording, stand_of(recording)))
    return joined(parts)


def _spooled(
    paths: list[Path], choice: Choice, spool: Spool, rows: int, progress: Progress | None
) -> tuple[tuple[int, ...], list[Diagnostic]]:
    """Write all columns and torque to the spool; where each recording ends in it, and what is to be said of them."""
    edges, diagnostics, read = [], [], 0
    for path in paths:
        with Recording(path) as recording:
            counts = []
            for part in stream(recording, stand_of(recording)):
                told, motion = choice.told(part.motion), part.motion
                spool.extend(choice.model.columns(motion)[told], choice.model.target(motion, part.torque)[told])
                counts.append(part.thinned(len(part)))
                read += len(part)
                if progress is not None:
                    progress("reading", min(1.0, read / rows))
            edges.append(spool.rows)
            diagnostics += recording_diagnostics(recording, joined(counts))
    return tuple(edges), diagnostics + _slow(read - spool.rows, read)
