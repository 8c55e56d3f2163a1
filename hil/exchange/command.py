"""The column with the set-points in an imported table: of torque, position, current or voltage.

The command is the instrument of the identification of Kc and Bc; only its shape matters, not its scale. A measured
channel cannot be an instrument, because an instrument must not contain the errors of the readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil import units
from hil.errors import WrongUse
from hil.exchange.headings import unit_of

Array = NDArray[np.float64]

MODES: Mapping[str, str] = MappingProxyType(
    {"torque": "torque", "angle": "position", "current": "current", "voltage": "voltage"}
)
"""The possible dimensions of a set-point, and the mode of the recording's profile for each."""

_KINDS: Final = "a torque, an angle, a current or a voltage"
_SAME: Final = 1e-12  # of the power, up to which two columns are one


def dimension_of_command(title: str, unit: str | None) -> str:
    """Return the dimension of a command from its unit: `unit` if given, otherwise the unit in the heading `title`.
    Raises WrongUse if there is no unit.
    """
    if unit is not None:
        found = next((one for one in MODES if units.known(one, unit) is not None), None)
        if found is None:
            raise WrongUse(f"--command-unit {unit}: a command is {_KINDS}: {_give()}")
        return found
    for dimension in MODES:
        try:
            if unit_of(title, dimension) is not None:
                return dimension
        except WrongUse:  # a heading of another dimension
            continue
    raise WrongUse(f"column {title!r} does not say whether the command is {_KINDS}: {_give()}")


def held(command: Array) -> Array:
    """Return set-points (n,) in which every empty cell (NaN) has the value of the row before."""
    good = np.isfinite(command)
    last = np.maximum.accumulate(np.where(good, np.arange(len(command)), -1))
    return np.where(last >= 0, command[last], np.nan)


def check_command(source: Path, name: str, channels: Mapping[str, Array]) -> None:
    """Raise WrongUse for a command that never changes, or that equals the measured torque or deflection."""
    command = channels["command"]
    good = np.isfinite(command)
    if np.ptp(command[good]) == 0.0:
        raise WrongUse(f"{source}: the command {name!r} is {command[good][0]:.4g} in every row: leave --command out")
    for channel in ("torque", "dtheta"):
        both = good & np.isfinite(channels[channel])
        if _is_same(command[both], channels[channel][both]):
            raise WrongUse(
                f"{source}: the command {name!r} is the {channel} that was read, whose errors it shares: name the "
                "column of the set-point, or leave --command out"
            )


def _is_same(one: Array, other: Array) -> bool:
    one, other = one - one.mean(), other - other.mean()
    power = float(one @ one) * float(other @ other)
    return power > 0.0 and power - float(one @ other) ** 2 <= _SAME * power


def _give() -> str:
    proposed = ", ".join(f"{units.COMMON[dimension][0]}" for dimension in MODES)
    return f"give its unit with --command-unit, such as {proposed}"
