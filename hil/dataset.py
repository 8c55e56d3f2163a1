"""From recordings to what the search takes: columns and torque, in memory where they fit, on disk where they do not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ga.models import Model
from hil.findings import Finding
from hil.signals import Signals, joined, prepare, stream
from hil.spool import Progress, Spool
from hil.stand import StandTable, parse
from hil.store import Recording

Array = NDArray[np.float64]
Keep = Callable[[NDArray[np.int64]], NDArray[np.bool_]]

IN_MEMORY = 4_000_000
"""Rows, of all recordings together, up to which they are held in memory."""

_ANCHOR = 1 << 18  # samples of the first recording that set what a model takes from its data
_SHOWN = 200_000  # samples of a larger recording that are kept for its picture and its bounds


@dataclass(frozen=True, slots=True)
class Dataset:
    """The recordings, pooled.

    model: anchored to them. signals: all of them, or of larger ones every so many-th. columns (m, p), torque (m,): of
    those signals. samples: of all. whole: whether the signals are all of them. findings: what is to be said of them.
    """

    model: Model
    signals: Signals
    columns: Array
    samples: int
    whole: bool
    findings: list[Finding]
    _table: Callable[[Keep | None], Iterable[tuple[Array, Array]]]

    @property
    def torque(self) -> Array:
        """The torque of the signals, (m,) N m."""
        return self.signals.torque

    def blocks(self, keep: Keep | None = None) -> Iterable[tuple[Array, Array]]:
        """Columns and torque of all samples in order, of those whose numbers (m,) `keep` says are kept."""
        return self._table(keep)


@contextmanager
def open_dataset(paths: list[Path], model: Model, progress: Progress | None = None) -> Iterator[Dataset]:
    """The recordings at `paths` for `model`. Raises WrongUse, Untrustworthy as reading and `prepare` do.

    progress is told of every going through recordings that do not fit in memory.
    """
    if _rows(paths) <= IN_MEMORY:
        yield _in_memory(paths, model)
        return
    with Spool(paths[0], _rows(paths), len(model.parameters), progress) as spool:
        yield _on_disk(paths, model, spool, progress)


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


def recording_findings(recording: Recording, signals: Signals) -> list[Finding]:
    """What any use of a recording must say of it: that it did not end, what was dropped, what was mended."""
    found = []
    if not recording.complete:
        why = str(recording.attributes.get("end_reason", "")) or "it never ended"
        found.append(
            Finding("unfinished", f"{recording.path} is not a whole run ({why}): its {len(recording)} rows are used")
        )
    if signals.lost:
        found.append(Finding("lost-samples", f"{signals.lost} of {len(recording)} replies were lost and are left out"))
    if signals.not_numbers:
        found.append(
            Finding("not-a-number", f"{signals.not_numbers} of {len(recording)} rows hold a NaN and are left out")
        )
    if signals.near_gaps:
        found.append(Finding("near-gaps", f"{signals.near_gaps} rows lie beside a gap, where no rate can be told"))
    if signals.coarse_clock:
        found.append(
            Finding("coarse-clock", "several rows share a time stamp: they were spread evenly up to the next stamp")
        )
    return found


def _in_memory(paths: list[Path], model: Model) -> Dataset:
    parts, findings = [], []
    for path in paths:
        with Recording(path) as recording:
            parts.append(prepare(recording, stand_of(recording)))
            findings += recording_findings(recording, parts[-1])
    signals = joined(parts)
    first = parts[0]
    model = model.anchored(first.time[:_ANCHOR], first.dtheta_dot[:_ANCHOR])
    columns = model.columns(signals.time, signals.dtheta, signals.dtheta_dot)

    def table(keep: Keep | None) -> Iterable[tuple[Array, Array]]:
        chosen = slice(None) if keep is None else keep(np.arange(len(signals)))
        return [(columns[chosen], signals.torque[chosen])]

    return Dataset(model, signals, columns, len(signals), True, findings, table)


def _on_disk(paths: list[Path], model: Model, spool: Spool, progress: Progress | None) -> Dataset:
    rows = _rows(paths)
    every = 1 + rows // _SHOWN
    shown, findings = [], []
    for path in paths:
        with Recording(path) as recording:
            parts = []
            for part in stream(recording, stand_of(recording)):
                if model.smoothing is None:
                    model = model.anchored(part.time[:_ANCHOR], part.dtheta_dot[:_ANCHOR])
                spool.extend(model.columns(part.time, part.dtheta, part.dtheta_dot), part.torque)
                parts.append(part.thinned(every))
                if progress is not None:
                    progress("reading", min(1.0, spool.rows / rows))
            shown.append(joined(parts))
            findings += recording_findings(recording, shown[-1])
    signals = joined(shown)
    columns = model.columns(signals.time, signals.dtheta, signals.dtheta_dot)
    return Dataset(model, signals, columns, spool.rows, False, findings, spool.blocks)
