"""Import a table as a recording: with named columns, units, signs and row filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil import units
from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.exchange import checks
from hil.exchange.checks import PAIRS
from hil.exchange.columns import NoCommonRow, Table, UnequalLengths, open_table
from hil.exchange.expression import quoted_name
from hil.exchange.headings import heading, listed, unit_of
from hil.exchange.join import Join, joined, side
from hil.exchange.mending import fractions, signs, stamps
from hil.exchange.mending.rate import counted
from hil.exchange.other_joints import OtherJoints, other_joints
from hil.exchange.row_filter import RowFilter
from hil.exchange.tables import Side, by_rows, by_time, opened
from hil.exchange.wanted import MODES, Column, Part, dimension_of_command, parts_of
from hil.printable import quoted
from hil.recording.channels import CHANNELS
from hil.recording.interval import rows_between
from hil.recording.writer import Header, write
from hil.signals.plausibility import Swing, in_words
from hil.stand.file import Stand
from hil.stand.transmission import Transmission, Zero

__all__ = ["Column", "Imported", "import_table"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_MOST = 64  # columns in which the fraction of a second is looked for
_TOGETHER = 0.1  # share of the rarer readings, up to which torque and deflection stand in different rows
_COARSE = 0.01  # share of rows with the stamp of the row before, and other readings, from which the clock is coarse


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


class Understood(NamedTuple):
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
    rate: float | None = None,
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
    a joint state, whose effort is the torque and whose position is the deflection. where: the filters. rate: of even
    rows, Hz, that have no time, or only a counter as time. topic, joint: those of a bag. join: a second file of the
    run. between: the first and the last time to import, as a user writes them. force: replace an existing recording.
    Raises WrongUse for a column without a known unit, for readings that the stand's limits make impossible, and for a
    wrong row.
    """
    sides, columns, found, said = understand(
        source, columns, where, rate=rate, topic=topic, joint=joint, join=join, stand=stand
    )
    channels, rows = found.channels, found.rows
    if between != (None, None):
        kept = rows_between(source, channels["time"], found.factors.get("time", 1.0), *between)
        channels, rows = {name: values[kept] for name, values in channels.items()}, rows[kept]
    if columns:
        _at_the_joint(channels, stand)
    mode = dict[str, str | float]()
    if "command" in columns:
        checks.check_command(source, columns["command"].name, channels)
        mode = {"mode": MODES[dimension_of_command("", found.units["command"])]}
    others = _others(sides, columns, rows) if columns else None
    swings = [
        Swing.of(channels[joint], found.factors.get(joint) or found.factors.get(motor, 1.0)) for joint, motor in PAIRS
    ]
    diagnostics = [*map(_mended, found.mended), *checks.plausible(source, swings, channels, stand)]
    if others is not None:
        mode |= others.attributes
        diagnostics.append(Diagnostic("other-joints", others.message))
    header = Header(
        profile={"kind": "imported", "source": source.name, "where": " and ".join(str(item) for item in where)} | mode,
        stand_toml="" if stand is None else stand.text,
        command_line=command_line,
    )
    write(target, header, channels, force=force)
    duration = float(channels["time"][-1] - channels["time"][0])
    return Imported(len(rows), duration, found.units, in_words(swings[0], swings[1]), tuple(diagnostics), said)


@np.errstate(all="ignore")
def understand(
    source: Path,
    columns: Mapping[str, Column],
    where: Sequence[RowFilter] = (),
    *,
    rate: float | None = None,
    topic: str | None = None,
    joint: str | None = None,
    join: Join | None = None,
    stand: Stand | None = None,
) -> tuple[list[Side], Mapping[str, Column], Understood, str]:
    """Return the tables, the columns that are read, their channels, and how a second table was joined.

    The arguments are those of `import_table`. Raises WrongUse.
    """
    is_self = join is not None and join.path.resolve() == source.resolve()
    if is_self:
        columns = {
            channel: replace(one, name=one.name.removeprefix(f"{source.name}:")) for channel, one in columns.items()
        }
    sides = opened(source, columns, where, (topic, joint), join=join is not None and not is_self)
    table, said = sides[0].table, ""
    columns = (
        _with_joint_state(table, sides[0].columns) if len(sides) == 1 else {**sides[1].columns, **sides[0].columns}
    )
    if columns:
        checks.check_channels(table, columns, stand, rate)
    if join is not None and columns and not is_self:
        sides = _of_files(table, join, columns, where)
    elif len(sides) == 1 and rate is None:
        sides = by_time(sides[0]._replace(columns=columns), None if join is None else join.time)
    try:
        found = _channels(table, columns, sides[0].where, rate) if len(sides) == 1 else None
    except (UnequalLengths, NoCommonRow) as error:
        sides, found = by_rows(sides[0]._replace(columns=columns), error, None if join is None else join.time), None
    if found is None:
        found, said = _joined(sides, shared=join is None or join.shared or is_self, is_one_file=join is None or is_self)
    time = columns.get("time")
    if time is not None and time.unit is None and rate is None:
        checks.refuse_wrong_time_unit(source, time.name, found.channels["time"], found.units["time"])
    checks.refuse_unsigned(source, found.channels, found.factors, columns)
    return sides, columns, found, said


def _others(sides: Sequence[Side], columns: Mapping[str, Column], rows: Rows) -> OtherJoints | None:
    """Return the other joints in the table of the deflection; of two tables, in all its rows."""
    order = sorted(columns, key=lambda one: (one not in PAIRS[1], one not in PAIRS[0]))
    named = [(side, side.columns if len(sides) > 1 else columns) for side in sides]
    read = [(side, name, own[name]) for name in order for side, own in named if name in own]
    used = [part.title for side, name, one in read for part in parts_of(side.table, name, one)[1]]
    titles = [title for side in sides for title in side.table.titles]
    table, where = read[0][0].table, read[0][0].where
    return other_joints(table, used, titles, rows if len(sides) == 1 else None, where)


def _mended(what: str) -> Diagnostic:
    return Diagnostic(
        "mended-table", f"{what}. Kc and Bc come from the other rows, or from the mended ones; check the logger"
    )


def _of_files(first: Table, join: Join, columns: Mapping[str, Column], where: Sequence[RowFilter]) -> list[Side]:
    """Return the tables of two files, each with the channels whose columns it has."""
    second = open_table(join.path)
    found = {channel: side(one.name, first, second) for channel, one in columns.items() if channel != "time"}
    sides = []
    for table in (first, second):
        own = {channel: replace(columns[channel], name=name) for channel, (at, name) in found.items() if at is table}
        time = columns["time"].name if table is first or join.time is None else join.time
        filters = [one for one in where if table.has(one.column) and (table is first or not first.has(one.column))]
        sides.append(Side(str(table.source), table, own | {"time": replace(columns["time"], name=time)}, filters))
    return sides


def _joined(sides: Sequence[Side], *, shared: bool, is_one_file: bool) -> tuple[Understood, str]:
    """Return the channels of two tables at the times of the slower one, and what was done, in words."""
    one, two = (_channels(side.table, side.columns, side.where, one_clock=True) for side in sides)
    channels, said = joined((Path(sides[0].name), one.channels), (Path(sides[1].name), two.channels), shared=shared)
    used, factors = two.units | one.units, two.factors | one.factors
    if is_one_file:
        said = f"the times of {sides[0].name} and {sides[1].name} are read as those of one clock"
    return Understood(channels, np.arange(len(channels["time"])), used, factors, [*one.mended, *two.mended]), said


def _channels(
    table: Table,
    columns: Mapping[str, Column],
    where: Sequence[RowFilter],
    rate: float | None = None,
    *,
    one_clock: bool = False,
) -> Understood:
    """Return the channels of a table in the order of time. columns: {} for an export of hil. one_clock: whether to
    refuse times that go back.
    """
    found = _in_si(table, columns, where, rate)
    if "command" in columns:
        found.channels["command"] = _held(found.channels["command"])
    channels, rows, twice = _once(found.channels, found.rows)
    if columns:
        channels, rows = _with_readings(table.source, channels, rows)
    unit = found.factors.get("time", 1.0)
    try:
        channels, rows, mended = stamps.in_order(table.source, channels, rows, unit, one_clock=one_clock)
    except fractions.WholeSeconds as error:
        raise WrongUse(f"{error}{_fraction(table, columns['time'], found, where)}") from None
    return Understood(channels, rows, found.units, found.factors, [*found.mended, *twice, *mended])


def _fraction(table: Table, time: Column, read: Understood, where: Sequence[RowFilter]) -> str:
    """Return the option that adds the column with the fraction of a second to the times; "" without such a column."""
    titles = [(title, partial(lambda title: table.read([title], where)[0][0], title)) for title in table.titles[:_MOST]]
    if (column := fractions.fraction(read.channels["time"], titles)) is None:
        return ""
    first, second = map(quoted_name, (time.name, column[0]))
    unit = "" if unit_of(column[0], "time") else f"[{column[1]}]"
    return ". The fraction is in a column beside: --time " + quoted(f"{first} + {second}{unit}")


def _in_si(
    table: Table, columns: Mapping[str, Column], where: Sequence[RowFilter], rate: float | None = None
) -> Understood:
    """Return the channels of a table in the order in which they are written. columns: {} for an export of hil.

    Raises WrongUse for a column without a number or a known unit, and for a wrong row.
    """
    if rate is not None and "time" in columns:
        columns = {**columns, "time": replace(columns["time"], unit="s")}
    known = {channel: parts_of(table, channel, column) for channel, column in columns.items()}
    checks.refuse_same(table, known)
    parts = {channel: found for channel, (_, found) in known.items()} or _own(table)
    titles = list(dict.fromkeys(part.title for found in parts.values() for part in found))
    numbers, rows = table.read(titles, where)
    raw = dict(zip(titles, numbers, strict=True))
    for channel, (dimension, found) in known.items():  # dates and times in texts are read as s
        is_s = [dimension == "time" and part.unit is None and part.title in table.stamps for part in found]
        known[channel] = (
            dimension,
            [part._replace(unit="s") if s else part for part, s in zip(found, is_s, strict=True)],
        )
    channels, used, factors = {name: raw[found[0].title] for name, found in parts.items()}, dict[str, str](), {}
    checks.check_numbers(table, known, raw)
    for channel, (dimension, found) in known.items():
        si, code = units.COMMON[dimension][0], columns[channel].code or "none"
        used[channel] = found[0].unit or si if len(found) == 1 else si
        factors[channel] = units.factor(dimension, used[channel])
        weights = [part.factor * units.factor(dimension, part.unit or si) for part in found]
        channels[channel] = weights @ np.stack([signs.decoded(raw[part.title], code) for part in found])
    checks.refuse_alternating(table.source, known, channels)
    if "time" in known and len(times := known["time"][1]) > 1:
        fractions.check_sum(
            table.source,
            [(one.named, raw[one.title] * (units.factor("time", one.unit or "s") * one.factor)) for one in times],
        )
    if rate is not None:
        channels["time"], factors["time"] = counted(channels.get("time"), rows, rate)
        used["time"] = f"rows at {rate:.9g} Hz"
    return Understood(channels, rows, used, factors, list(table.lost))


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
    same = [(one[1:] == one[:-1]) | (np.isnan(one[1:]) & np.isnan(one[:-1])) for one in channels.values()]
    kept = ~np.append(False, np.all(same, axis=0))
    twice, times = len(rows) - np.count_nonzero(kept), channels["time"][kept]
    if not twice or np.count_nonzero(times[1:] == times[:-1]) > _COARSE * len(rows):
        return channels, rows, []
    said = f"{twice} of {len(rows)} rows repeat the row before and are left out"
    return {name: values[kept] for name, values in channels.items()}, rows[kept], [said]


def _with_readings(source: Path, channels: dict[str, Array], rows: Rows) -> tuple[dict[str, Array], Rows]:
    """Remove rows without a reading, which a table of several topics has. Raises NoCommonRow if few rows have both
    torque and deflection.
    """
    read = {name: np.isfinite(values) for name, values in channels.items() if name != "time"}
    load, angle = (next((read[one] for one in pair if one in read), None) for pair in PAIRS)
    if load is not None and angle is not None:
        both, rarer = np.count_nonzero(load & angle), min(np.count_nonzero(load), np.count_nonzero(angle))
        if both <= _TOGETHER * rarer:
            raise NoCommonRow(
                f"{source}: {both} rows have both torque and deflection: export them from one topic, or resample them",
                [
                    one
                    for one, known in read.items()
                    if np.count_nonzero(known & angle) > np.count_nonzero(known & load)
                ],
            )
    kept = np.any([known for name, known in read.items() if name != "command"], axis=0)
    return {name: values[kept] for name, values in channels.items()}, rows[kept]


def _with_joint_state(table: Table, columns: Mapping[str, Column]) -> Mapping[str, Column]:
    """Return `columns`. If the table is a joint state, add its columns for the channels that `columns` lacks."""
    if not {"time [s]", "position [rad]"} <= set(table.titles):
        return columns
    added = {} if "time" in columns else {"time": Column("time")}
    if not {"torque", "motor_torque"} & set(columns):
        if not table.has("effort"):
            other = f", TOPIC:PATH for one of another topic; {found}" if (found := table.topics()) else ""
            raise WrongUse(f"{table.source}: the joint state has no effort; name the torque with --torque{other}")
        added["torque"] = Column("effort")
    if not {"dtheta", "motor_position"} & set(columns):
        added["dtheta"] = Column("position")
    return {**added, **columns}


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
