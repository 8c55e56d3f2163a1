"""Build the data of the search from recordings: signals in memory if they fit, otherwise a table of columns on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ga.arrays import Array, Mask
from hil.diagnostics import Diagnostic
from hil.identification.candidates.choice import Choice
from hil.identification.fitting.blocks import Block, Blocks
from hil.identification.fitting.disk_table import DiskTable
from hil.identification.fitting.unloaded import Rest, Unloaded, unloaded
from hil.recording.ahead import Progress, ahead
from hil.signals import constants as c
from hil.signals.defects import Defects
from hil.signals.prepare import LongRecording, Signals, joined, prepare, refuse_at_rest
from hil.signals.quality import assess, recording_diagnostics
from hil.signals.source import Source
from hil.signals.zero_steps import zero_steps

Choose = Callable[[Signals, bool], Choice]
"""A function that returns the model for signals; its second argument says whether these are all signals."""


@dataclass(frozen=True, slots=True, eq=False)
class Dataset:
    """The pooled recordings and the model that is fitted to them.

    choice: the model, anchored to the recordings, and why it was chosen. signals: all signals, or pieces of them if
    they do not fit in memory. whole: whether `signals` are all signals. used (n,): which samples of `signals` are
    fitted. blocks: columns of the linear parameters, and torque, of all fitted samples. in_memory: columns and torque
    of the fitted samples in `signals`. edges: the row of the blocks at which each recording ends. place: the deflection
    at which the joint is unloaded, from which the deflections of the signals count.
    """

    choice: Choice
    signals: Signals
    used: Mask
    whole: bool
    blocks: Blocks
    in_memory: Block
    edges: tuple[int, ...]
    place: Unloaded
    diagnostics: list[Diagnostic]

    @property
    def samples(self) -> int:
        """Return the number of fitted samples."""
        return self.blocks.rows


@contextmanager
def open_dataset(
    sources: Sequence[Source], choose: Choose, progress: Progress | None = None, *, rest: Rest = unloaded
) -> Iterator[Dataset]:
    """Pool the recordings, with the model that `choose` returns.

    progress: a function that is called at every pass through recordings that do not fit in memory. rest: a function
    that finds the unloaded deflection, from which deflections count. Raises WrongUse, and Untrustworthy
    for a damaged or changed recording.
    """
    for source in sources:
        source.verify(progress)
    rows = sum(len(source.recording) for source in sources)
    if rows <= c.IN_MEMORY:
        yield _in_memory(sources, choose, rest)
        return
    long = [LongRecording(source.recording, source.table) for source in sources]
    glimpses = [one.glimpse() for one in long]
    signals = joined([stretch for stretches in glimpses for stretch in stretches])
    place = rest(signals)
    signals = signals.counted_from(place.reference)
    choice = choose(signals, False)
    with DiskTable(sources[0].path, rows, len(choice.model.linear), progress) as table:
        edges, diagnostics = _to_disk(
            sources, list(zip(long, glimpses, strict=True)), choice, table, progress, reference=place.reference
        )
        used = choice.described(signals)
        seen = _rows(choice, signals, used)
        yield Dataset(choice, signals, used, False, table.blocks, seen, edges, place, diagnostics)


def _in_memory(sources: Sequence[Source], choose: Choose, rest: Rest) -> Dataset:
    parts, diagnostics = [], []
    for source in sources:
        part = prepare(source.recording, source.table)
        refuse_at_rest(source.recording, part)
        parts.append(replace(part, command=_command(source, part)))
        diagnostics += _diagnostics(source, [part], part.defects)
    signals = joined(parts)
    place = rest(signals)
    signals = signals.counted_from(place.reference)
    diagnostics += _other_zero(place.reference)
    choice = choose(signals, True)
    used = choice.described(signals)
    rows = _rows(choice, signals, used)
    blocks = Blocks.of(*rows)
    edges = tuple(np.cumsum(used)[np.cumsum([len(part) for part in parts]) - 1].tolist())
    diagnostics += _slow(int(np.count_nonzero(~choice.moving(signals.motion))), len(used))
    return Dataset(choice, signals, used, True, blocks, rows, edges, place, diagnostics)


def _other_zero(reference: float) -> list[Diagnostic]:
    if reference == 0.0:
        return []
    text = (
        f"the joint seems to be unloaded at {reference:.4g} rad and not at the encoder's zero. Deflections count from "
        "there, so Kc and Bc are not affected. Set the encoder's zero with the joint unloaded"
    )
    return [Diagnostic("unloaded-place", text)]


def _command(source: Source, part: Signals) -> Array | None:
    """Return the set-points (n,) at the times of the signals; None if they were not recorded."""
    time, command = source.recording.channel("time"), source.recording.channel("command")
    good = np.isfinite(time) & np.isfinite(command)
    return np.interp(part.motion.time, time[good], command[good]) if good.any() else None


def _to_disk(
    sources: Sequence[Source],
    long: Sequence[tuple[LongRecording, list[Signals]]],
    choice: Choice,
    table: DiskTable,
    progress: Progress | None,
    *,
    reference: float,
) -> tuple[tuple[int, ...], list[Diagnostic]]:
    """Write all columns and the torque to the table; return the row at which each recording ends, and the
    diagnostics.
    """
    edges, diagnostics, read, held = [], [], 0, 0
    rows = sum(len(source.recording) for source in sources)
    for source, (recording, stretches) in zip(sources, long, strict=True):
        defects = Defects()
        for part in (part.counted_from(reference) for part in ahead(recording.stream())):
            table.extend(*_rows(choice, part, choice.described(part)))
            defects += part.defects
            read += len(part)
            held += int(np.count_nonzero(~choice.moving(part.motion)))
            if progress is not None:
                progress("reading", min(1.0, read / rows))
        edges.append(table.rows)
        diagnostics += [*_diagnostics(source, stretches, defects), *_unmended(source, joined(stretches))]
    return tuple(edges), diagnostics + _other_zero(reference) + _slow(held, read)


def _rows(choice: Choice, signals: Signals, used: Mask) -> Block:
    """Return columns (m, p) and torque (m,) of the samples in `used`, with the nonlinear parameters at zero."""
    model, motion = choice.model, signals.motion
    columns, target = model.columns(motion), model.target(motion, signals.torque)
    kept = slice(None) if used.all() else used  # mostly all are: nothing need be copied
    return np.ascontiguousarray(columns[kept]), target[kept]


def _diagnostics(source: Source, stretches: list[Signals], defects: Defects) -> list[Diagnostic]:
    return recording_diagnostics(source.recording, assess(source.recording, stretches, defects), source.limits)


def _unmended(source: Source, pieces: Signals) -> list[Diagnostic]:
    """Return an error where a zero changes between pieces of a recording too long for memory."""
    steps = zero_steps(pieces.motion, pieces.as_read - pieces.motion.known) if len(pieces) > c.FEWEST else []
    if not steps:
        return []
    where = "; ".join(f"of the {one.channel} between {one.before:.6g} s and {one.time:.6g} s" for one in steps)
    text = (
        f"{source.path}: a zero changes, as after a tare or a restart: {where}. In a recording of more than "
        f"{c.IN_MEMORY} rows this is not corrected, so Kc and Bc are wrong. Identify the rows before and after it "
        "alone, with --from and --to"
    )
    return [Diagnostic("not-identifiable", text, is_error=True)]


def _slow(left_out: int, samples: int) -> list[Diagnostic]:
    if not left_out:
        return []
    text = (
        f"{left_out} of {samples} samples are left out: the joint is so slow there that friction may hold it. They "
        "say nothing about Kc or Bc. Drive faster"
    )
    return [Diagnostic("slow-samples", text)]
