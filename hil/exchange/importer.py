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
from hil.exchange.columns import Table, open_table
from hil.exchange.command import MODES, check_command, dimension_of_command, held
from hil.exchange.headings import heading, listed
from hil.exchange.mending import clock, signs
from hil.exchange.row_filter import RowFilter
from hil.exchange.wanted.chosen import DIMENSION, Column, dimensions_of, give, units_of, with_sums
from hil.exchange.wanted.join import Join, Part, joined, side
from hil.recording.channels import CHANNELS
from hil.recording.interval import rows_between
from hil.recording.writer import Header, write
from hil.signals.plausibility import GROSS, Swing, excess, implausible, in_words
from hil.stand.file import Stand
from hil.stand.transmission import Transmission, Zero

__all__ = ["Column", "Imported", "import_table"]

Array = NDArray[np.float64]

_COARSE = 0.01  # share of rows with the stamp of the row before, and other readings, from which the clock is coarse
_PAIRS = (("torque", "motor_torque"), ("dtheta", "motor_position"))
_WHOLE = 0.05  # of a turn, within which the range of an encoder is one
_DAMAGED = 0.01  # share of the rows that may have no time
_SAME_SHAPE = 0.9  # share of the deflection's power that its rate must explain before their units are compared


@dataclass(frozen=True, slots=True)
class Imported:
    """The result of an import.

    samples: number of rows. duration: s. units: the unit that was used for each channel. ranges: ranges of torque and
    deflection, in words. diagnostics: warnings about the size of torque and deflection.
    """

    samples: int
    duration: float
    units: Mapping[str, str]
    ranges: str
    diagnostics: tuple[Diagnostic, ...]
    said: str = ""


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

    columns: for each channel its column (see DIMENSION): time; torque or motor_torque; dtheta or motor_position;
    command, the set-point, is optional. Motor channels are converted to the joint with the gear of `stand`. {}: the
    file is an export of hil, or a joint state, whose effort is the torque and whose position is the deflection. where:
    the filters. topic, joint: as in `open_table`. join: a second file of the run. between: the first and the last time,
    as in `rows_between`. force: replace an existing recording. Raises WrongUse for a column without a known unit, for
    readings that the stand's limits make impossible, and for a wrong row.
    """
    said = ""
    asked = set() if join else {column.name for column in columns.values()} | {one.column for one in where}
    table = open_table(source, topic=topic, joint=joint, asked=asked)
    columns = _with_joint_state(table, columns)
    if columns:
        _check_channels(columns, stand)
    if join is None or not columns:
        channels, rows, used, mended = _channels(table, columns, where)
    else:
        (channels, rows, used, mended), said = _of_two(table, join, columns, where)
    _refuse_unsigned(source, channels, columns, used)
    if between != (None, None):
        kept = rows_between(source, channels["time"], units.factor("time", used.get("time", "s")), *between)
        channels, rows = {name: values[kept] for name, values in channels.items()}, rows[kept]
    if columns:
        _complete(source, channels, stand)
    if "command" in columns:
        check_command(source, columns["command"].name, channels)
    swings = _swings(channels, used)
    diagnostics = _plausible(source, swings, stand)
    mode = {"mode": MODES[dimension_of_command("", used["command"])]} if "command" in columns else {}
    header = Header(
        profile={"kind": "imported", "source": source.name, "where": " and ".join(str(item) for item in where)} | mode,
        stand_toml="" if stand is None else stand.text,
        command_line=command_line,
    )
    write(target, header, channels, force=force)
    duration = float(channels["time"][-1] - channels["time"][0])
    return Imported(len(rows), duration, used, in_words(*swings), (*mended, *diagnostics), said)


class _Read(NamedTuple):
    """The channels of a table in SI, (n,) each, in the order of time; the numbers of their rows (n,); the units of the
    columns; and what was mended.
    """

    channels: dict[str, Array]
    rows: NDArray[np.int64]
    used: dict[str, str]
    mended: list[Diagnostic]


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
    files = Part(first.source, one.channels), Part(second.source, two.channels)
    channels, said = joined(*files, shared=join.shared)
    used = one.used | two.used | {"time": "s"}
    return _Read(channels, np.arange(len(channels["time"])), used, [*one.mended, *two.mended]), said


def _channels(
    table: Table, columns: Mapping[str, Column], where: Sequence[RowFilter], *, one_clock: bool = False
) -> _Read:
    """Return the channels of a table. columns: {} for an export of hil. one_clock: whether a clock that was set is
    refused.
    """
    table, columns = with_sums(table, columns)
    names = {channel: column.name for channel, column in columns.items()} or _own(table)
    titles, source = {name: table.titles[table.place(one.name)] for name, one in columns.items()}, table.source
    dimensions, understood = dimensions_of(titles, columns), units_of(titles, columns)
    numbers, rows = _read(table, names, where)
    numbers, rows, repeated = _once(list(names).index("time"), numbers, rows)
    channels = dict(zip(names, numbers, strict=True))
    _check_readings(source, channels, columns)
    used = _all_stated(source, channels, columns, understood)
    for channel, unit in used.items():
        column = columns[channel]
        read = channels[channel] if column.code is None else signs.decoded(channels[channel], column.code)
        channels[channel] = read * (column.scale * units.factor(dimensions[channel], unit))
    seconds = units.factor("time", used.get("time", "s"))
    channels, rows, of_time = _timed(source, channels, rows, seconds, one_clock=one_clock)
    return _Read(channels, rows, used, [*map(_mended, table.lost), *repeated, *of_time])


def _read(table: Table, names: Mapping[str, str], where: Sequence[RowFilter]) -> tuple[Array, NDArray[np.int64]]:
    """Return each channel (channels, n) and the row numbers (n,). names: the column of each channel."""
    numbers, rows = table.read(list(names.values()), where)
    if "command" in names:
        numbers[list(names).index("command")] = held(numbers[list(names).index("command")])
    return _with_readings(table.source, list(names), numbers, rows) if table.joins_topics else (numbers, rows)


def _once(time: int, numbers: Array, rows: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64], list[Diagnostic]]:
    """Remove rows that a logger wrote twice; otherwise they would be used as samples at different times.

    If a coarse clock gives many rows the same time, rows with equal readings are not removed: a joint at rest has equal
    readings.
    """
    kept = np.concatenate([[True], (numbers[:, 1:] != numbers[:, :-1]).any(axis=0)])
    twice, stamps = len(rows) - np.count_nonzero(kept), numbers[time, kept]
    if not twice or np.count_nonzero(stamps[1:] == stamps[:-1]) > _COARSE * len(rows):
        return numbers, rows, []
    message = f"{twice} of {len(rows)} rows repeat the row before and are left out"
    return numbers[:, kept], rows[kept], [_mended(message)]


def _all_stated(
    source: Path, channels: Mapping[str, Array], columns: Mapping[str, Column], stated: Mapping[str, str | None]
) -> dict[str, str]:
    """Return the unit of each channel. Raises WrongUse, with the ranges of the values, if the unit of a column is
    unknown.
    """
    missing = [
        f"{columns[channel].name!r} ({_raw_range(channels[channel])}): {give(channel)}"
        for channel, unit in stated.items()
        if unit is None
    ]
    if missing:
        raise WrongUse(
            f"{source} does not say the unit of {'; of '.join(missing)}. Or write the units in the headings, as in "
            "'torque [mN*m]': a wrong one makes Kc wrong by its factor"
        )
    return {channel: unit for channel, unit in stated.items() if unit is not None}


def _refuse_unsigned(
    source: Path, channels: Mapping[str, Array], columns: Mapping[str, Column], used: Mapping[str, str]
) -> None:
    """Raise WrongUse, with the code that decodes them, for numbers without their sign.

    An encoder that passes a whole turn needs no code: identification removes such jumps.
    """
    pair = [next((one for one in pair if one in columns), "") for pair in _PAIRS]
    if "" in pair:
        return
    factors = [columns[one].scale * units.factor(DIMENSION[one], used[one]) for one in pair]
    raw = [channels[one] / factor for one, factor in zip(pair, factors, strict=True)]
    for channel, option, values, factor, code in zip(
        pair, ("torque", "dtheta"), raw, factors, signs.recognised(raw[0], raw[1]), strict=True
    ):
        turns = signs.size_of(code) * abs(factor) / math.tau if code.startswith("wrap") else 0.0
        is_turn = option == "dtheta" and math.isclose(turns, 1.0, rel_tol=_WHOLE)
        if code == "none" or is_turn or columns[channel].code is not None:
            continue
        raise WrongUse(
            f"{source}: the numbers of {columns[channel].name!r} lack their sign. They are {_raw_range(values)}, "
            f"and jump where the {'torque' if option == 'torque' else 'angle'} passes zero, as those of a register do "
            "that was read without a sign, so that neither Kc nor Bc can come from them. Decode them with "
            f"--{option}-code {code}"
        )


def _check_readings(source: Path, channels: Mapping[str, Array], columns: Mapping[str, Column]) -> None:
    """Raise WrongUse if a named column contains no number."""
    for channel, column in columns.items():
        if not np.isfinite(channels[channel]).any():
            raise WrongUse(f"{source}: column {column.name!r} holds no number: name another, or check --where")


def _raw_range(values: Array) -> str:
    good = values[np.isfinite(values)]
    return f"{good.min():.4g} to {good.max():.4g}" if good.size else "no number"


def _swings(channels: Mapping[str, Array], used: Mapping[str, str]) -> tuple[Swing, Swing]:
    """Return the smallest and largest value of torque and deflection, with their units."""
    found = []
    for joint, motor in _PAIRS:
        unit = used.get(joint) or used.get(motor)
        factor = 1.0 if unit is None else units.factor(DIMENSION[joint], unit)
        found.append(Swing.of(channels[joint], factor))
    return found[0], found[1]


def _plausible(source: Path, swings: tuple[Swing, Swing], stand: Stand | None) -> list[Diagnostic]:
    """Return warnings about implausible sizes of torque and deflection. Raises WrongUse if a unit must be wrong."""
    limits = None if stand is None else stand.limits
    found = implausible(*swings, limits)
    if limits is not None and found and excess(*swings, limits) > GROSS:
        raise WrongUse(f"{source}: {found[0].message}")
    return [replace(one, is_error=False) for one in found]  # an error of a result, which an import has not


def _with_joint_state(table: Table, columns: Mapping[str, Column]) -> Mapping[str, Column]:
    """Return the columns. If the table is a joint state, its columns are added for the channels without a column."""
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


def _with_readings(
    source: Path, names: Sequence[str], numbers: Array, rows: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Remove rows without a new reading. Raises WrongUse if no row has both torque and deflection."""
    read = np.isfinite(numbers[[at for at, name in enumerate(names) if name not in {"time", "command"}]])
    if not read.all(axis=0).any():
        raise WrongUse(f"{source}: no row has both torque and deflection: export them from one topic, or resample them")
    return numbers[:, read.any(axis=0)], rows[read.any(axis=0)]


def _own(table: Table) -> dict[str, str]:
    """Return the heading of each channel in a file that `hil export` wrote; a .mat file has the channels' names as
    headings.
    """
    for found in ({name: heading(name) for name in CHANNELS}, {name: name for name in CHANNELS}):
        if set(found.values()) <= set(table.titles):
            return {name: title for name, title in found.items() if name != "seq"}  # the rows are numbered anew
    raise WrongUse(
        f"name the columns of {table.source} with --time, --torque and --dtheta; it has {listed(table.titles)}"
    )


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
            raise WrongUse(f"{options[1]} needs --stand: its gear_ratio brings the motor's side to the joint")
    if stand is not None and "motor_torque" in columns and stand.stand.torque_source != "motor":
        raise WrongUse('the stand has torque_source = "joint": name the torque cell\'s column with --torque')
    for channel, column in columns.items():
        if not np.isfinite(column.scale) or column.scale == 0.0:
            raise WrongUse(f"{channel} cannot be scaled by {column.scale:g}: give a number that is not zero")


def _timed(
    source: Path, channels: Mapping[str, Array], rows: NDArray[np.int64], unit: float, *, one_clock: bool
) -> tuple[dict[str, Array], NDArray[np.int64], list[Diagnostic]]:
    """Return the channels and the numbers of their rows in the order of time, with diagnostics of what was mended.

    unit: of the time, s. one_clock: whether times may not go back. Raises WrongUse for times that are missing in many
    rows, or that go back again and again.
    """
    known, found = np.isfinite(channels["time"]), list[Diagnostic]()
    bad = np.flatnonzero(~known)
    if bad.size > _DAMAGED * len(known):
        raise WrongUse(
            f"{source}, row {rows[bad[0]]}: the time is not a number, in {bad.size} of {len(known)} rows: delete these "
            "rows, or fill in their times; a gap does no harm"
        )
    if bad.size:
        found.append(_mended(f"{bad.size} of {len(known)} rows have no time and are left out"))
    time, span = clock.unwrapped(channels["time"][known], unit)
    if span:
        found.append(_mended(f"the time begins anew after {span:.7g} s, the range of its counter, and is continued"))
    order = clock.order(time)
    if (wrong := clock.astray(time[order])).any() and np.count_nonzero(wrong) <= _DAMAGED * len(order):
        found.append(_mended(f"{np.count_nonzero(wrong)} of {len(order)} rows have a wrong time and are left out"))
        order = order[~wrong]
    if moved := np.count_nonzero(np.diff(order) < 0):
        found.append(
            _mended(f"rows are out of order, in {moved} places of {len(order)}; they are sorted by their times")
        )
    time, pieces = clock.continued(source, time[order], rows[known][order])
    if pieces and one_clock:
        raise WrongUse(f"{source}: {pieces}. No second file can be joined to such times: choose one part with --where")
    if pieces:
        found.append(_mended(pieces))
    if not found:
        return dict(channels), rows, []
    sorted_channels = {name: values[known][order] for name, values in channels.items()}
    return sorted_channels | {"time": time}, rows[known][order], found


def _mended(what: str) -> Diagnostic:
    return Diagnostic(
        "mended-table", f"{what}. Kc and Bc come from the other rows, or from the mended ones; check the logger"
    )


def _complete(source: Path, channels: dict[str, Array], stand: Stand | None) -> None:
    """Shift the time so that it begins at zero, and convert motor channels to the joint."""
    channels["time"] = channels["time"] - channels["time"][0]
    way = None if stand is None else Transmission.of(stand.stand)
    if way is not None and "motor_torque" in channels:
        channels["torque"] = way.torque(channels["motor_torque"])
    if way is not None and "motor_position" in channels:
        position = channels["motor_position"]
        rest = float(position[np.isfinite(position)][:1].sum())
        channels["dtheta"] = way.deflection(position, 0.0, Zero(rest))
    if "dtheta_dot" in channels:
        _check_rate(source, channels["time"], channels["dtheta"], channels["dtheta_dot"])


def _check_rate(source: Path, time: Array, dtheta: Array, rate: Array) -> None:
    """Raise WrongUse if the rate's integral has the shape of the deflection but another size: then a unit or sign is
    wrong.

    Both are compared without their linear trend, so that noise and a coarse clock have little effect. If their shapes
    differ, nothing is checked.
    """
    good = np.isfinite(dtheta) & np.isfinite(rate)
    time, dtheta, rate = time[good], dtheta[good], rate[good]
    if len(time) < 3 or np.ptp(time) == 0.0:
        return
    integral = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))))
    line = np.column_stack([np.ones_like(time), (time - time.mean()) / np.ptp(time)])
    both = np.column_stack([dtheta, integral])
    moved, implied = (both - line @ np.linalg.lstsq(line, both, rcond=None)[0]).T
    product, power = float(moved @ implied), float(implied @ implied) * float(moved @ moved)
    if power == 0.0 or product**2 < _SAME_SHAPE * power:
        return
    ratio = product / float(moved @ moved)
    if not 0.5 < ratio < 2.0:
        raise WrongUse(
            f"{source}: the deflection's rate is {ratio:.3g} times its derivative: their units or signs "
            "differ; give --dtheta-unit and --dtheta-dot-unit, or invert a sign with --dtheta-dot-scale -1"
        )
