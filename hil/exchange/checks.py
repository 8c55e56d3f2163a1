"""What is wrong with the columns of an import: missing, without a unit or a sign, of an impossible size."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil import units
from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.exchange.columns import Table
from hil.exchange.expression import quoted_name
from hil.exchange.mending import signs
from hil.exchange.mending.rate import advice
from hil.exchange.wanted import Column, Part, give
from hil.printable import quoted
from hil.signals.angle import outliers
from hil.signals.constants import GROSS
from hil.signals.plausibility import Swing, excess, unit_diagnostics
from hil.stand.file import Stand

Array = NDArray[np.float64]

PAIRS = (("torque", "motor_torque"), ("dtheta", "motor_position"))
"""The channels at the joint, and those of the motor that stand in for them."""

_ROWS = 100  # rows at least, whose times show their unit
_FAR_FROM_ZERO, _EVERY_OTHER = 0.05, 0.2  # of the range; share of the rows
_CLOSE, _SHORT, _FAR = 5e-5, 0.5, 0.5  # s between rows, s of the whole, s between rows
_ERAS = ((30_000.0, 60_000.0), (700_000.0, 770_000.0))  # days of spreadsheets and of MATLAB since 1982
_DAYS = "they are days, as a spreadsheet counts them: --time-unit d"
_WHOLE = 0.05  # of a turn, within which the range of an encoder is one
_SAME = 1e-12  # of the power, up to which two columns are one


def check_numbers(table: Table, known: Mapping[str, tuple[str, list[Part]]], raw: Mapping[str, Array]) -> None:
    """Raise WrongUse if a column contains no number, or if its unit is unknown, with the range of its values."""
    missing = []
    for channel, (dimension, found) in known.items():
        for part in found:
            if not np.isfinite(raw[part.title]).any():
                where = f", or {advice(table)}" if channel == "time" else ""
                raise WrongUse(
                    f"{table.source}: column {part.named!r} holds no number: name another, or check --where{where}"
                )
            if part.unit is None:
                how = f"write it behind the name, such as {part.named}[{units.COMMON[dimension][0]}], or "
                how = ("" if len(found) == 1 else how) + give(channel, dimension)
                how = _DAYS if channel == "time" and _are_days(raw[part.title]) else how
                missing.append(f"{part.named!r} ({_raw_range(raw[part.title])}): {how}")
    if missing:
        raise WrongUse(
            f"{table.source} does not say the unit of {'; of '.join(missing)}. Or write the units in the headings, as "
            "in 'torque [mN*m]': a wrong one makes Kc wrong by its factor"
        )


def _are_days(values: Array) -> bool:
    good = values[np.isfinite(values)]
    return any(low < good.min() and good.max() < high and np.ptp(good) < 1.0 for low, high in _ERAS)


def refuse_same(table: Table, known: Mapping[str, tuple[str, list[Part]]]) -> None:
    """Raise WrongUse if two of torque, deflection and time are one column."""
    roles = {"torque": PAIRS[0], "deflection": PAIRS[1], "time": ("time",)}
    own = {role: next((known[one][1] for one in names if one in known), []) for role, names in roles.items()}
    for (role, found), (other, second) in combinations(own.items(), 2):
        if found and {part.title for part in found} == {part.title for part in second}:
            texts = [(name, sorted(labels)) for name, labels in table.labels().items() if len(labels) > 1]
            rows = "".join(f"; where {name!r} names the rows, write {labels[0]}:COLUMN" for name, labels in texts[:1])
            why = ", so Kc would be a ratio of units" if other == "deflection" else ""
            raise WrongUse(
                f"{table.source}: {role} and {other} are both {found[0].named!r}{why}: name the column of each{rows}"
            )


def refuse_alternating(
    source: Path, known: Mapping[str, tuple[str, list[Part]]], channels: Mapping[str, Array]
) -> None:
    """Raise WrongUse for torque or deflection that is zero in every other row, as where two programs write one log."""
    for channel in (one for pair in PAIRS for one in pair if one in known):
        values = channels[channel]
        high = np.abs(values) > _FAR_FROM_ZERO * (np.ptp(values[np.isfinite(values)]) if len(values) else 0.0)
        zero = (values[1:-1] == 0.0) & high[:-2] & high[2:]
        if len(values) > _ROWS and np.count_nonzero(zero) > _EVERY_OTHER * len(values):
            name, count = known[channel][1][0].named, np.count_nonzero(zero)
            raise WrongUse(
                f"{source}: {name!r} is 0 between other readings in {count} of {len(values)} rows, so two programs "
                f"wrote one log, and neither Kc nor Bc can come from it: read the rows of one, such as with --where "
                f"{quoted(f'{name}!=0')}; where each wrote one of torque and angle, record each into its file"
            )


def refuse_wrong_time_unit(source: Path, name: str, time: Array, unit: str) -> None:
    """Raise WrongUse for times (n,), s, that are too close or too far apart for a logger. unit: the heading's."""
    if len(time) < _ROWS:
        return
    span = float(np.ptp(time))
    step = span / (len(time) - 1)
    if not (step < _CLOSE and span < _SHORT) and step < _FAR:
        return
    factor = f"1000*{quoted_name(name)}" if step < _CLOSE else f"{quoted_name(name)}/1000"
    raise WrongUse(
        f"{source}: {len(time)} times in {unit}, as the heading of {name!r} says, last {span:.4g} s, {step:.3g} s from "
        f"row to row, and Bc would be wrong by the factor of the unit. Where the heading is wrong by 1000: --time "
        f"{quoted(factor)}; where it is right: --time-unit {unit}"
    )


def _raw_range(values: Array) -> str:
    good = values[np.isfinite(values)]
    return f"{good.min():.4g} to {good.max():.4g}" if good.size else "no number"


def refuse_unsigned(
    source: Path, channels: Mapping[str, Array], factors: Mapping[str, float], columns: Mapping[str, Column]
) -> None:
    """Raise WrongUse for numbers that lack their sign; the message names the code that decodes them.

    An encoder that passes a whole turn needs no code: identification removes such jumps.
    """
    pair = [next((one for one in pair if one in columns), "") for pair in PAIRS]
    if "" in pair:
        return
    sizes = [columns[one].scale * factors[one] for one in pair]
    raw = [channels[one] / size for one, size in zip(pair, sizes, strict=True)]
    codes = signs.recognised(raw[0], raw[1])
    for channel, option, values, size, code in zip(pair, ("torque", "dtheta"), raw, sizes, codes, strict=True):
        turns = signs.size_of(code) * abs(size) / math.tau if code.startswith("wrap") else 0.0
        is_turn = option == "dtheta" and math.isclose(turns, 1.0, rel_tol=_WHOLE)
        if code != "none" and not is_turn and columns[channel].code is None:
            what = "torque" if option == "torque" else "angle"
            raise WrongUse(
                f"{source}: the numbers of {columns[channel].name!r} lack their sign. They are {_raw_range(values)}, "
                f"and jump where the {what} passes zero, as those of a register do that was read without a sign, so "
                f"that neither Kc nor Bc can come from them. Decode them with --{option}-code {code}"
            )


def plausible(source: Path, swings: list[Swing], channels: dict[str, Array], stand: Stand | None) -> list[Diagnostic]:
    """Return warnings about implausible sizes of torque and deflection. Raises WrongUse if a unit must be wrong."""
    limits = None if stand is None else stand.limits
    torque, dtheta = swings
    found = unit_diagnostics(torque, dtheta, limits)
    if limits is not None and found:  # single wrong readings are beyond any limit
        good = np.isfinite([channels[name] for name in ("time", "torque", "dtheta")]).all(axis=0)
        read = channels["torque"][good]
        torque = Swing.of(read[~outliers(channels["time"][good], read, channels["dtheta"][good])], torque.factor)
        found = unit_diagnostics(torque, dtheta, limits)
        if found and excess(torque, dtheta, limits) > GROSS:
            raise WrongUse(f"{source}: {found[0].message}")
    return [replace(one, is_error=False) for one in found]  # an error of a result, which an import has not


def check_channels(table: Table, columns: Mapping[str, Column], stand: Stand | None, rate: float | None) -> None:
    """Raise WrongUse if a channel has no column or two, or cannot be converted to the joint. rate: of even rows, Hz."""
    if "time" not in columns and rate is None:
        raise WrongUse(f"name the column of the time with --time; or, where {table.source} has none, {advice(table)}")
    if rate is not None and not 0.0 < rate < math.inf:
        raise WrongUse(f"--rate {rate:g} is no rate: give the rows per second, such as --rate 500")
    for joint, motor in PAIRS:
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


def check_command(source: Path, name: str, channels: Mapping[str, Array]) -> None:
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
