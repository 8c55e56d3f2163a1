"""The final file of a recording: compressed samples with one dataset for each channel, and hashes of everything that
affects a result.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from hil.recording.channels import CHANNELS, ROW, Row, Rows
from hil.recording.integrity import header_hash, plain, stored_hash
from hil.recording.lateness import Lateness
from hil.recording.output import atomic_write, check_space
from hil.recording.reader import BLOCK, SCHEMA, Event, Recording

Channels = Mapping[str, NDArray[np.float64]]

_LEVEL = 6  # of the deflation
OVERHEAD = 1 << 18
"""The size of a file apart from its samples, bytes: an upper estimate."""


class Finalised(NamedTuple):
    """The result of writing a final file: the number of rows, and the number of damaged rows, which are stored as lost.

    trusted: whether the source still matched its hash; otherwise the final file gets no hash. damage: see `Recording`.
    """

    samples: int
    damaged: int
    trusted: bool
    damage: str


def finalise(
    source: Path, output: Path, *, end_reason: str | None = None, force: bool = False, channels: Channels | None = None
) -> Finalised:
    """Write the recording `source` (finished or in progress, any known schema) to `output` as a final file.

    The output appears complete or not at all; `source` is not changed. end_reason: why the run ended; None marks the
    recording as recovered. force: replace an existing file. channels: (n,) each, SI, in place of the rows of `source`;
    a missing one has no reading. Raises WrongUse if the output cannot be written.
    """
    with Recording(source) as recording:
        length = len(recording) if channels is None else len(channels["time"])
        done = Finalised(length, recording.damaged, _is_trusted(recording), recording.damage)
        check_space(output, length * ROW.itemsize + OVERHEAD)
        with (
            atomic_write(output, force=force) as temporary,  # which has locked it already
            h5py.File(temporary, "w", libver="latest", locking=False) as file,
        ):
            attributes = {name: value for name, value in recording.attributes.items() if name != "sha256_header"}
            write_attributes(file, attributes, recording.profile, recording.truth())
            file.attrs["complete"] = end_reason == "done"
            file.attrs["end_reason"] = "recovered" if end_reason is None else end_reason
            blocks = recording.rows if channels is None else partial(_blocks, channels, length)
            file.attrs.update(_write_samples(file, blocks, length, _rate(recording)))
            events = [*recording.events(), *([Event(0.0, "damaged-rows", done.damage)] if done.damage else [])]
            _write_events(file, events)
            if done.trusted:
                sign(file, recording.truth(), events)
            else:
                file.attrs["sha256_header"] = ""
        return done


def _is_trusted(recording: Recording) -> bool:
    return recording.header_intact() if recording.live else recording.verify()


def write_attributes(
    file: h5py.File, attributes: Mapping[str, Any], profile: Mapping[str, Any], truth: Mapping[str, float]
) -> None:
    """Write attributes, profile and truth into an empty file."""
    file.attrs.update({**attributes, "schema": SCHEMA})
    file.create_group("profile").attrs.update(profile)
    if truth:
        file.create_group("truth").attrs.update(truth)


def sign(file: h5py.File, truth: Mapping[str, float], events: list[Event]) -> None:
    """Add the hash of the header to the file; the header must be complete."""
    attributes, profile = plain(file.attrs), plain(file["profile"].attrs)
    truth = {name: float(value) for name, value in truth.items()}
    file.attrs["sha256_header"] = header_hash(attributes, profile, truth, events)


def _blocks(channels: Channels, length: int) -> Iterator[tuple[int, Rows]]:
    """Yield the rows of channels in blocks, each with the index of its first row. The next block has the same array."""
    rows = np.full(min(BLOCK, length), np.array(Row(0), dtype=ROW))
    for start in range(0, length, BLOCK):
        rows = rows[: length - start]
        rows["seq"] = np.arange(start, start + len(rows))
        for name, values in channels.items():
            rows[name] = values[start : start + BLOCK]
        yield start, rows


def _write_samples(
    file: h5py.File, blocks: Callable[[], Iterator[tuple[int, Rows]]], length: int, rate: float
) -> dict[str, str | float]:
    """Write the rows in the blocks; return the attributes that are computed from the rows, such as hashes and lateness.

    If the torque equals the torque cell's reading in every row, it is stored once, under both names.
    """
    group = file.create_group("samples")
    names = [name for name in CHANNELS if name != "joint_torque" or not _from_cell(blocks)]
    _, first = next(blocks(), (0, np.empty(0, dtype=ROW)))
    for name in names:
        _create_channel(group, name, length, first[name][: BLOCK // 4])
    if "joint_torque" not in names:
        group["joint_torque"] = group["torque"]
    digest, lateness = hashlib.sha256(), Lateness(rate)
    before = dict[str, bytes]()
    for start, rows in blocks():
        for name in names:
            before[name] = _write_block(group[name], start, rows[name].tobytes(), before.get(name, b""))
        digest.update(rows.tobytes())
        lateness.add(rows)
    file.flush()
    stored = stored_hash(group, CHANNELS)
    return {"sha256": digest.hexdigest(), "sha256_stored": stored, **lateness.attributes()}


def _write_block(dataset: h5py.Dataset, start: int, values: bytes, before: bytes) -> bytes:
    """Write the values of a block, and return them. before: those of the block before it; of equal blocks, as of a
    channel without readings, only the first is compressed.
    """
    if values == before:
        mask, chunk = dataset.id.read_direct_chunk((start - BLOCK,))
        dataset.id.write_direct_chunk((start,), chunk, mask)
    else:
        block = np.frombuffer(values, dtype=dataset.dtype)
        dataset[start : start + len(block)] = block
    return values


def _create_channel(group: h5py.Group, name: str, length: int, first: NDArray[Any]) -> None:
    """Create an empty channel of `length` rows, with the compression that suits its `first` values."""
    dataset = group.create_dataset(
        name,
        shape=(length,),
        maxshape=(length or None,),  # HDF5 has no chunks for what is empty and must stay so
        dtype=ROW[name],
        chunks=(min(BLOCK, max(length, 1)),),  # the deflation needs a long stretch to learn from
        shuffle=_shrinks_shuffled(first),
        compression="gzip",
        compression_opts=_LEVEL,
        fletcher32=True,
    )
    unit, description = CHANNELS[name]
    dataset.attrs.update(unit=unit, description=description)


def _shrinks_shuffled(values: NDArray[Any]) -> bool:
    """Return whether values compress better with their bytes shuffled, as the values of a smooth channel do.

    A channel of a coarse sensor has few different values, and compresses to half the size without shuffling.
    """
    data = np.ascontiguousarray(values)
    sorted_ = data.view(np.uint8).reshape(-1, data.itemsize).T.tobytes()
    return len(zlib.compress(sorted_, _LEVEL)) <= len(zlib.compress(data.tobytes(), _LEVEL))


def _from_cell(blocks: Callable[[], Iterator[tuple[int, Rows]]]) -> bool:
    """Return whether the torque equals the torque cell's reading, to the last bit, in every row."""
    count = 0
    for _, rows in blocks():
        if rows["torque"].tobytes() != rows["joint_torque"].tobytes():
            return False
        count += len(rows)
    return count > 0


def _rate(recording: Recording) -> float:
    """Return the rate of the ticks, Hz; NaN for imported data."""
    return float(recording.profile.get("rate", np.nan)) if recording.profile.get("kind") != "import" else np.nan


def _write_events(file: h5py.File, events: list[Event]) -> None:
    group = file.create_group("events")
    for name, dtype in (("time", "<f8"), ("code", h5py.string_dtype()), ("message", h5py.string_dtype())):
        group.create_dataset(name, data=[getattr(event, name) for event in events], dtype=dtype)
