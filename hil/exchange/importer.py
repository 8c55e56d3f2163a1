"""Import a table as a recording: with named columns, units, signs and row filters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil import units
from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.exchange import mending
from hil.exchange.columns import Table, open_table
from hil.exchange.headings import heading, listed
from hil.exchange.join import Join, joined, side
from hil.exchange.row_filter import RowFilter
from hil.exchange.wanted import MODES, Column, Part, dimension_of_command, give, parts_of
from hil.recording.channels import CHANNELS
from hil.recording.interval import rows_between
from hil.recording.writer import Header, write
from hil.signals.constants import GROSS
from hil.signals.plausibility import Swing, excess, implausible, in_words
from hil.stand.file import Stand
from hil.stand.transmission import Transmission, Zero

__all__ = ["Column", "Imported", "import_table"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_COARSE = 0.01  # share of rows with the stamp of the row before, and other readings, from which the clock is coarse
_PAIRS = (("torque", "motor_torque"), ("dtheta", "motor_position"))
_WHOLE = 0.05  # of a turn, within which the range of an encoder is one
_SAME = 1e-12  # of the power, up to which two columns are one


@dataclass(frozen=True, slots=True)
class Imported:
    """The result of an import.

    samples: number of rows. duration: s. units: the unit that was used for each channel. ranges: ranges of torque and
    deflection, in words. diagnostics: warnings about the table, and about the size of torque and deflection. said: how
    a second file was joined.
    """

    samples: int
    duration: float
    units: Mapping[str, str]
    ranges: str
    diagnostics: tuple[Diagnostic, ...]
    said: str = ""


class _Read(NamedTuple):
    """The channels of a table in SI, (n,) each; the numbers of their rows (n,); the unit of each
    channel's column, and the factor of the unit to SI; and what was mended.
    """

    channels: dict[str, Array]
    rows: Rows
    units: dict[str, str]
    factors: dict[str, float]
    mended: list[str]


@np.errstate(all="ignore")  # the numbers of a table may be anything; those that are not finite are missing
def import_table(
    source: Path,
    target: Path,
    columns: Mapping[str, Column],
    where: Sequence[RowFilter],
    *,
    topic: str | None = None,
    joint: str | None = None,
    join: Join | None = None,
    between: tuple[str | None, str | None] = (None, None),
    stand: Stand | None = None,
    command_line: str = "",
    force: bool = False,
) -> Imported:
    """Write a recording from the rows of a table that pass every filter.

    columns: the column of each channel: time; torque or motor_torque; dtheta or motor_position; optionally command, the
    set-point. Motor channels are converted to the joint with the gear of `stand`. {}: the file is an export of hil, or
    a joint state, whose effort is the torque and whose position is the deflection. where: the filters. topic, joint:
    those of a bag. join: a second file of the run. between: the first and the last time to import, as a user writes
    them. force: replace an existing recording. Raises WrongUse for a column without a known unit, for readings that the
    stand's limits make impossible, and for a wrong row.
    """
    asked = set() if join else {column.name for column in columns.values()} | {one.column for one in where}
    table, said = open_table(source, topic=topic, joint=joint, asked=asked), ""
    columns = _with_joint_state(table, columns)
    if columns:
        _check_channels(columns, stand)
    if join is None or not columns:
        found = _channels(table, columns, where)
    else:
        found, said = _of_two(table, join, columns, where)
    _refuse_unsigned(source, found, columns)
    channels, rows = found.channels, found.rows
    if between != (None, None):
        kept = rows_between(source, channels["time"], found.factors.get("time", 1.0), *between)
        channels, rows = {name: values[kept] for name, values in channels.items()}, rows[kept]
    if columns:
        _at_the_joint(channels, stand)
    mode = {}
    if "command" in columns:
        _check_command(source, columns["command"].name, channels)
        mode = {"mode": MODES[dimension_of_command("", found.units["command"])]}
    swings = [
        Swing.of(channels[joint], found.factors.get(joint) or found.factors.get(motor, 1.0)) for joint, motor in _PAIRS
    ]
    diagnostics = [*map(_mended, found.mended), *_plausible(source, swings[0], swings[1], stand)]
    header = Header(
        profile={"kind": "imported", "source": source.name, "where": " and ".join(str(item) for item in where)} | mode,
        stand_toml="" if stand is None else stand.text,
        command_line=command_line,
    )
    write(target, header, channels, force=force)
    duration = float(channels["time"][-1] - channels["time"][0])
    return Imported(len(rows), duration, found.units, in_words(swings[0], swings[1]), tuple(diagnostics), said)


def _mended(what: str) -> Diagnostic:
    return Diagnostic(
        "mended-table", f"{what}. Kc and Bc come from the other rows, or from the mended ones; check the logger"
    )


def _of_two(first: Table, join: Join, columns: Mapping[str, Column], where: Sequence[RowFilter]) -> tuple[_Read, str]:
    """Return the channels of two files at the times of the slower one, and what was done, in words."""
    second = open_table(join.path)
    sides = {channel: side(one.name, first, second) for channel, one in columns.items() if channel != "time"}
    reads = []
    for table in (first, second):
        own = {channel: replace(columns[channel], name=name) for channel, (at, name) in sides.items() if at is table}
        time = columns["time"].name if table is first or join.time is None else join.time
        filters = [one for one in where if table.has(one.column) and (table is first or not first.has(one.column))]
        reads.append(_channels(table, own | {"time": replace(columns["time"], name=time)}, filters, one_clock=True))
    one, two = reads
    channels, said = joined((first.source, one.channels), (second.source, two.channels), shared=join.shared)
    used, factors = two.units | one.units, two.factors | one.factors
    return _Read(channels, np.arange(len(channels["time"])), used, factors, [*one.mended, *two.mended]), said


def _channels(
    table: Table, columns: Mapping[str, Column], where: Sequence[RowFilter], *, one_clock: bool = False
) -> _Read:
    """Return the channels of a table in the order of time. columns: {} for an export of hil. one_clock: whether to
    refuse times that go back.
    """
    found = _in_si(table, columns, where)
    if "command" in columns:
        found.channels["command"] = _held(found.channels["command"])
    channels, rows, twice = _once(found.channels, found.rows)
    if columns:
        channels, rows = _with_readings(table.source, channels, rows)
    unit = found.factors.get("time", 1.0)
    channels, rows, mended = mending.in_order(table.source, channels, rows, unit, one_clock=one_clock)
    return _Read(channels, rows, found.units, found.factors, [*found.mended, *twice, *mended])


def _in_si(table: Table, columns: Mapping[str, Column], where: Sequence[RowFilter]) -> _Read:
    """Return the channels of a table in the order in which they are written. columns: {} for an export of hil.

    Raises WrongUse for a column without a number or a known unit, and for a wrong row.
    """
    known = {channel: parts_of(table, channel, column) for channel, column in columns.items()}
    parts = {channel: found for channel, (_, found) in known.items()} or _own(table)
    titles = list(dict.fromkeys(part.title for found in parts.values() for part in found))
    numbers, rows = table.read(titles, where)
    raw = dict(zip(titles, numbers, strict=True))
    channels, used, factors = {name: raw[found[0].title] for name, found in parts.items()}, dict[str, str](), {}
    _check_numbers(table.source, known, raw)
    for channel, (dimension, found) in known.items():
        si, code = units.COMMON[dimension][0], columns[channel].code or "none"
        used[channel] = found[0].unit or si if len(found) == 1 else si
        factors[channel] = units.factor(dimension, used[channel])
        weights = [part.factor * units.factor(dimension, part.unit or si) for part in found]
        channels[channel] = weights @ np.stack([mending.decoded(raw[part.title], code) for part in found])
    return _Read(channels, rows, used, factors, list(table.lost))


def _own(table: Table) -> dict[str, list[Part]]:
    """Return the column of each channel in a file that `hil export` wrote; a .mat file has the channels' names as
    headings.
    """
    for found in ({name: heading(name) for name in CHANNELS}, {name: name for name in CHANNELS}):
        if set(found.values()) <= set(table.titles):  # the rows are numbered anew
            return {name: [Part(title, None, 1.0, title)] for name, title in found.items() if name != "seq"}
    raise WrongUse(
        f"name the columns of {table.source} with --time, --torque and --dtheta; it has {listed(table.titles)}"
    )


def _held(command: Array) -> Array:
    """Return set-points (n,) in which every empty cell (NaN) has the value of the row before."""
    good = np.isfinite(command)
    last = np.maximum.accumulate(np.where(good, np.arange(len(command)), -1))
    return np.where(last >= 0, command[last], np.nan)


def _once(channels: dict[str, Array], rows: Rows) -> tuple[dict[str, Array], Rows, list[str]]:
    """Remove rows (of all `channels`) that a logger wrote twice; otherwise they would be used as samples at different
    times.

    If a coarse clock gives many rows the same time, rows with equal readings are not removed: a joint at rest has equal
    readings.
    """
    kept = np.append(True, np.any([values[1:] != values[:-1] for values in channels.values()], axis=0))
    twice, times = len(rows) - np.count_nonzero(kept), channels["time"][kept]
    if not twice or np.count_nonzero(times[1:] == times[:-1]) > _COARSE * len(rows):
        return channels, rows, []
    said = f"{twice} of {len(rows)} rows repeat the row before and are left out"
    return {name: values[kept] for name, values in channels.items()}, rows[kept], [said]


def _check_numbers(source: Path, known: Mapping[str, tuple[str, list[Part]]], raw: Mapping[str, Array]) -> None:
    """Raise WrongUse if a column contains no number, or if its unit is unknown, with the range of its values."""
    missing = []
    for channel, (dimension, found) in known.items():
        for part in found:
            if not np.isfinite(raw[part.title]).any():
                raise WrongUse(f"{source}: column {part.named!r} holds no number: name another, or check --where")
            if part.unit is None:
                how = f"write it behind the name, such as {part.named}[{units.COMMON[dimension][0]}], or "
                how = "" if len(found) == 1 else how
                missing.append(f"{part.named!r} ({_raw_range(raw[part.title])}): {how}{give(channel, dimension)}")
    if missing:
        raise WrongUse(
            f"{source} does not say the unit of {'; of '.join(missing)}. Or write the units in the headings, as in "
            "'torque [mN*m]': a wrong one makes Kc wrong by its factor"
        )


def _raw_range(values: Array) -> str:
    good = values[np.isfinite(values)]
    return f"{good.min():.4g} to {good.max():.4g}" if good.size else "no number"


def _with_readings(source: Path, channels: dict[str, Array], rows: Rows) -> tuple[dict[str, Array], Rows]:
    """Remove rows without a reading, which a table of several topics has. Raises WrongUse if no row has both torque and
    deflection.
    """
    read = np.isfinite([values for name, values in channels.items() if name not in {"time", "command"}])
    if not read.all(axis=0).any():
        raise WrongUse(f"{source}: no row has both torque and deflection: export them from one topic, or resample them")
    kept = read.any(axis=0)
    return {name: values[kept] for name, values in channels.items()}, rows[kept]


def _refuse_unsigned(source: Path, found: _Read, columns: Mapping[str, Column]) -> None:
    """Raise WrongUse for numbers that lack their sign; the message names the code that decodes them.

    An encoder that passes a whole turn needs no code: identification removes such jumps.
    """
    pair = [next((one for one in pair if one in columns), "") for pair in _PAIRS]
    if "" in pair:
        return
    sizes = [columns[one].scale * found.factors[one] for one in pair]
    raw = [found.channels[one] / size for one, size in zip(pair, sizes, strict=True)]
    codes = mending.recognised(raw[0], raw[1])
    for channel, option, values, size, code in zip(pair, ("torque", "dtheta"), raw, sizes, codes, strict=True):
        turns = mending.size_of(code) * abs(size) / math.tau if code.startswith("wrap") else 0.0
        is_turn = option == "dtheta" and math.isclose(turns, 1.0, rel_tol=_WHOLE)
        if code != "none" and not is_turn and columns[channel].code is None:
            what = "torque" if option == "torque" else "angle"
            raise WrongUse(
                f"{source}: the numbers of {columns[channel].name!r} lack their sign. They are {_raw_range(values)}, "
                f"and jump where the {what} passes zero, as those of a register do that was read without a sign, so "
                f"that neither Kc nor Bc can come from them. Decode them with --{option}-code {code}"
            )


def _plausible(source: Path, torque: Swing, dtheta: Swing, stand: Stand | None) -> list[Diagnostic]:
    """Return warnings about implausible sizes of torque and deflection. Raises WrongUse if a unit must be wrong."""
    limits = None if stand is None else stand.limits
    found = implausible(torque, dtheta, limits)
    if limits is not None and found and excess(torque, dtheta, limits) > GROSS:
        raise WrongUse(f"{source}: {found[0].message}")
    return [replace(one, is_error=False) for one in found]  # an error of a result, which an import has not


def _with_joint_state(table: Table, columns: Mapping[str, Column]) -> Mapping[str, Column]:
    """Return `columns`. If the table is a joint state, add its columns for the channels that `columns` lacks."""
    if not {"time [s]", "position [rad]"} <= set(table.titles):
        return columns
    added = {} if "time" in columns else {"time": Column("time")}
    if not {"torque", "motor_torque"} & set(columns):
        if not table.has("effort"):
            raise WrongUse(f"{table.source}: the joint state has no effort; name the torque with --torque")
        added["torque"] = Column("effort")
    if not {"dtheta", "motor_position"} & set(columns):
        added["dtheta"] = Column("position")
    return {**added, **columns}


def _check_channels(columns: Mapping[str, Column], stand: Stand | None) -> None:
    if "time" not in columns:
        raise WrongUse("name the column of the time with --time")
    for joint, motor in _PAIRS:
        options = f"--{joint}", f"--{motor.replace('_', '-')}"
        if joint in columns and motor in columns:
            raise WrongUse(f"give either {options[0]} or {options[1]}, not both")
        if joint not in columns and motor not in columns:
            raise WrongUse(f"name the columns: {options[0]}, or {options[1]} with --stand, is missing")
        if motor in columns and stand is None:
            raise WrongUse(f"{options[1]} needs --stand: its gear_ratio converts motor values to the joint")
    if stand is not None and "motor_torque" in columns and stand.stand.torque_source != "motor":
        raise WrongUse('the stand has torque_source = "joint": name the torque cell\'s column with --torque')
    for channel, column in columns.items():
        if not np.isfinite(column.scale) or column.scale == 0.0:
            raise WrongUse(f"{channel} cannot be scaled by {column.scale:g}: give a number that is not zero")


def _at_the_joint(channels: dict[str, Array], stand: Stand | None) -> None:
    """Shift the time so that it begins at zero, and convert motor channels to the joint."""
    channels["time"] = channels["time"] - channels["time"][0]
    way = None if stand is None else Transmission.of(stand.stand)
    if way is not None and "motor_torque" in channels:
        channels["torque"] = way.torque(channels["motor_torque"])
    if way is not None and "motor_position" in channels:
        position = channels["motor_position"]
        rest = float(position[np.isfinite(position)][:1].sum())
        channels["dtheta"] = way.deflection(position, 0.0, Zero(rest))


def _check_command(source: Path, name: str, channels: Mapping[str, Array]) -> None:
    """Raise WrongUse for a command that never changes, or that equals the measured torque or deflection.

    A measured channel cannot be an instrument, because an instrument must not contain the errors of the readings.
    """
    command = channels["command"]
    good = np.isfinite(command)
    if np.ptp(command[good]) == 0.0:
        raise WrongUse(f"{source}: the command {name!r} is {command[good][0]:.4g} in every row: leave --command out")
    for channel in ("torque", "dtheta"):
        both = good & np.isfinite(channels[channel])
        one, other = (values[both] - values[both].mean() for values in (command, channels[channel]))
        power = float(one @ one) * float(other @ other)
        if power > 0.0 and power - float(one @ other) ** 2 <= _SAME * power:
            raise WrongUse(
                f"{source}: the command {name!r} is the {channel} that was read, whose errors it shares: name the "
                "column of the set-point, or leave --command out"
            )
