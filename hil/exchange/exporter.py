"""Export a recording with every row and channel as CSV, Parquet, MATLAB or MCAP."""

from __future__ import annotations

import csv
import gzip
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from hil.errors import WrongUse, meant
from hil.exchange import models
from hil.exchange.coupling import Coupling
from hil.exchange.headings import heading
from hil.exchange.readers.arrow import parquet
from hil.exchange.readers.bags import JOINT_STATE, SAMPLE
from hil.recording.channels import CHANNELS, ROW
from hil.recording.interval import Given
from hil.recording.output import atomic_write
from hil.recording.reader import Recording

JOINT = "joint"
"""The name of the joint in the joint states of an exported MCAP."""

_RULER = "=" * 80
_HEADER = f"""{_RULER}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULER}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_STATES = f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER}"
_SAMPLES = "".join(f"{'uint64' if ROW[name].kind == 'u' else 'float64'} {name}\n" for name in CHANNELS)
_LARGEST_MAT = 1 << 31  # bytes of a variable in a MAT-file of version 7
_LATEST = (1 << 31) * 10**9  # ns since 1970 that a time stamp of ROS 2 holds


class TableFormat(NamedTuple):
    """A file format for recordings: its suffixes, the function that writes it, and the check that its library is
    installed.
    """

    suffixes: tuple[str, ...]
    write: Callable[[Recording, Path], None]
    check: Callable[[Path], object] | None = None


def format_of(target: Path, given: str | None) -> str:
    """Return the name of the output's format: `given`, or if that is None the format of the suffix.

    Raises WrongUse for an unknown format, and if the suffix contradicts `given`.
    """
    suffixes = {name: one.suffixes for name, one in TABLES.items()}
    suffixes |= {name: (one.suffix,) for name, one in models.FORMATS.items()}
    of_name = next((name for name, ends in suffixes.items() if target.name.lower().endswith(ends)), None)
    known = ", ".join(f"{name} ({', '.join(ends)})" for name, ends in suffixes.items())
    if given is not None and given not in suffixes:
        raise WrongUse(f"unknown --format {given!r}: {meant(given, suffixes)}known are {known}")
    if of_name is None:
        what = f"--format {given}" if given else "an export"
        wanted = " or ".join(suffixes[given]) if given else f"one of {known}"
        raise WrongUse(f"{target}: the name of {what} ends in {wanted}: name the output so")
    if given is not None and given != of_name:
        raise WrongUse(
            f"{target} says {of_name} by its name, and --format says {given}: name the output "
            f"{target.with_suffix(suffixes[given][0])}, or omit --format"
        )
    return of_name


def export(given: Given, target: Path, *, force: bool = False) -> int:
    """Write every row of a recording or a part of it, with every channel in SI, and return the number of rows.

    A NaN becomes an empty cell in CSV. No digit is lost: `hil import` without column options reads the same numbers
    back. force: replace an existing file.
    Raises WrongUse, and Untrustworthy for a recording that is damaged or was changed.
    """
    name = format_of(target, None)
    if name not in TABLES:
        raise WrongUse(
            f"{target} cannot hold a recording: {name} is a format for the result of hil identify; name a file "
            f"that ends in {' or '.join(suffix for one in TABLES.values() for suffix in one.suffixes)}"
        )
    form = TABLES[name]
    if form.check is not None:
        form.check(target)
    with Recording(given) as recording, atomic_write(target, force=force) as temporary:
        recording.check_unchanged()
        form.write(recording, temporary)
        return len(recording)


def export_coupling(coupling: Coupling, target: Path, *, force: bool = False) -> None:
    """Write the coupling as a model; the name of `target` determines the format. force: replace an existing file.
    Raises WrongUse.
    """
    form = models.FORMATS[format_of(target, None)]
    with atomic_write(target, force=force) as temporary:
        temporary.write_text(form.text(coupling), encoding="utf-8")


def _write_csv(recording: Recording, target: Path) -> None:
    with (gzip.open if target.suffix == ".gz" else open)(target, "wt", encoding="utf-8", newline="") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([heading(name) for name in CHANNELS])
        for _, rows in recording.rows():
            for row in rows.tolist():
                writer.writerow(["" if isinstance(value, float) and math.isnan(value) else value for value in row])


def _write_parquet(recording: Recording, target: Path) -> None:
    module = parquet(target)
    import pyarrow

    schema = pyarrow.schema([(heading(name), pyarrow.float64()) for name in CHANNELS])
    with module.ParquetWriter(target, schema) as writer:
        for _, rows in recording.rows():
            columns = {heading(name): rows[name].astype("f8") for name in CHANNELS}
            writer.write_table(pyarrow.table(columns, schema=schema))


def _write_mat(recording: Recording, target: Path) -> None:
    """Write each channel as a column vector, and the units of all channels as a struct."""
    from scipy.io import savemat

    if len(recording) * 8 >= _LARGEST_MAT:
        raise WrongUse(f"{recording.path} is longer than a MAT-file can hold: export it as Parquet")
    channels: dict[str, Any] = {name: recording.channel(name) for name in CHANNELS}
    channels["units"] = {name: channel.unit for name, channel in CHANNELS.items()}
    with target.open("wb") as file:
        savemat(file, channels, do_compression=True, oned_as="column")


def _check_mcap(target: Path) -> None:
    try:
        import mcap_ros2.writer  # noqa: F401 - only whether it is there
    except ImportError:
        raise WrongUse(f"{target}: MCAP needs mcap-ros2-support: pip install 'hil[ros]', or use CSV") from None


def _write_mcap(recording: Recording, target: Path) -> None:
    """Write two messages for each row: a joint state, which every ROS tool shows, and a sample with all channels."""
    from mcap_ros2.writer import Writer

    start = 0  # ns since 1970, if the recording does not say when it was made
    with suppress(ValueError):
        start = int(datetime.fromisoformat(str(recording.attributes.get("created", ""))).timestamp()) * 10**9
    with target.open("wb") as file:
        writer: Any = Writer(file)
        states = writer.register_msgdef(JOINT_STATE, _STATES)
        samples = writer.register_msgdef(SAMPLE, _SAMPLES)
        stamp = start
        for _, rows in recording.rows():
            for row in rows:
                stamp = _stamp(start, float(row["time"]), stamp)
                sample = {name: row[name].item() for name in CHANNELS}
                writer.write_message("/hil/sample", samples, sample, log_time=stamp, publish_time=stamp)
                writer.write_message("/joint_states", states, _state(sample, stamp), log_time=stamp, publish_time=stamp)
        writer.finish()


def _stamp(start: int, time: float, last: int) -> int:
    """Return the time stamp of a row, ns since 1970; the stamp `last` if the row has no time. Raises WrongUse."""
    stamp = start + round(time * 1e9) if math.isfinite(time) else last
    if not 0 <= stamp < _LATEST:
        raise WrongUse(f"a row has the time {time:.3g} s, which a time stamp of ROS cannot hold: export it as CSV")
    return stamp


def _state(sample: Mapping[str, float], stamp: int) -> dict[str, Any]:
    """Return a row as a joint state: the deflection as position, its rate as velocity, the torque as effort."""
    seconds, nanoseconds = divmod(stamp, 10**9)
    fields = {"position": "dtheta", "velocity": "dtheta_dot", "effort": "torque"}
    header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": ""}
    return {"header": header, "name": [JOINT], **{field: [sample[name]] for field, name in fields.items()}}


TABLES: Mapping[str, TableFormat] = MappingProxyType(
    {
        "csv": TableFormat((".csv", ".csv.gz"), _write_csv),
        "parquet": TableFormat((".parquet", ".pq"), _write_parquet, parquet),
        "mat": TableFormat((".mat",), _write_mat),
        "mcap": TableFormat((".mcap",), _write_mcap, _check_mcap),
    }
)
"""All file formats for a recording, by the name that --format takes."""
