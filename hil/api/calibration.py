"""Calibrations of a stand, measured and stored in the stand file: torque cell, its delay, fixture and zero."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers.clock import Clock
from hil.api.analysis import identify
from hil.api.results import IdentificationResult
from hil.calibration.points import Load
from hil.calibration.session import TorqueCell, motor_at_rest, released, steady
from hil.calibration.step import StepResponse, step_response
from hil.calibration.torque import GRAVITY_UNCERTAINTY, Point, Scale, fit, implausible
from hil.errors import Untrustworthy, WrongUse
from hil.hand.edit import update
from hil.hand.file import load_stand
from hil.recording.reader import Recording
from hil.stand.file import Stand

_NORMAL = 1.96


@dataclass(frozen=True, slots=True)
class Zero:
    """The motor's angle at rest, rad, and its standard uncertainty, rad."""

    value: float
    uncertainty: float


def read_loads(
    stand: Stand, loads: Iterable[Load], cell: TorqueCell | None, clock: Clock, ready: Callable[[Load], bool]
) -> list[Point]:
    """Return the torque and the cell's reading of each known load. A missing reading is taken from `cell`.

    ready: called before a load is read; returns whether the person has hung the load. If not, the load is left out.
    Raises WrongUse for an impossible load, DriverError if the connection to the cell is lost.
    """
    sign = stand.sensor[1].sign if stand.sensor is not None else 1
    limit = None if stand.limits is None else stand.limits.torque
    points: list[Point] = []
    for one in loads:
        value = one.value
        if value is None and cell is not None:
            if not ready(one):
                continue
            value = steady(cell, clock).mean
        if value is None:
            raise WrongUse(f"{one.name} has no value, and there is no cell to read it from")
        points.append(Point(one.torque, sign * value, one.name))
        if problem := implausible(points, limit):
            raise WrongUse(problem)
    return points


def store_torque(
    path: Path, points: Sequence[Point], *, tare: float, arm: tuple[float, float] | None, joint: str | None = None
) -> tuple[Scale, list[str]]:
    """Fit the cell's scale to the known loads and store it in the stand file at `path`; return the scale and the
    changed keys.

    tare: the cell's reading without load, in counts or as printed. arm: length of the lever and its standard
    uncertainty, m; None if torques were given. joint: of a hand's file. Raises WrongUse for too few loads,
    Untrustworthy if the readings do not lie on a rising line. The file is changed only on success.
    """
    stand = load_stand(path, joint)
    lever = 0.0 if arm is None else math.hypot(arm[1] / arm[0], GRAVITY_UNCERTAINTY)
    found = fit(points, lever)
    measured: dict[str, Any] = {
        "date": _now(),
        "scale": _digits(found.scale, 9),
        "uncertainty": _digits(found.uncertainty),
        "offset": _digits(tare + found.offset, 9),
        "residual": _digits(found.residual),
        "points": found.points,
    }
    if math.isfinite(found.hysteresis):
        measured["hysteresis"] = _digits(found.hysteresis)
    changes: dict[str, dict[str, Any]] = {
        "joint_sensor": {"scale": measured["scale"]},
        "calibration.torque": measured,
    }
    if stand.stand.torque_source == "joint":
        changes["stand"] = {"torque_uncertainty": measured["uncertainty"]}
    update(path, changes, joint or "")
    return found, [f"{table}.{key}" for table, keys in changes.items() if "." not in table for key in keys]


def store_step(path: Path, cell: TorqueCell, clock: Clock, joint: str | None = None) -> StepResponse:
    """Measure the cell's delay and bandwidth from a load that is taken off within ten seconds, and store them in the
    stand file.

    path: of the stand file. joint: of a hand's file. Raises Untrustworthy if there is no clear step, DriverError if the
    connection to the cell is lost.
    """
    rows = released(cell, clock)
    found = step_response(*rows.T)
    delay = _digits(found.delay)
    update(
        path,
        {
            "joint_sensor": {"delay": delay},
            "calibration.step": {
                "date": _now(),
                "delay": delay,
                "uncertainty": _digits(found.uncertainty),
                "bandwidth": _digits(found.bandwidth),
            },
        },
        joint or "",
    )
    return found


def store_zero(path: Path, ready: Callable[[str], object], joint: str | None = None) -> Zero:
    """Measure the motor's angle at rest and store it as `stand.zero` in the stand file at `path`; return the angle.

    The angle is read twice, because friction holds a joint where it stops: the person turns the motor first to one
    side, then to the other. joint: of a hand's file. ready: called with the instruction before each reading. Raises
    DriverError, and Untrustworthy if the motor moves.
    """
    stand = load_stand(path, joint)
    angles, counts = [], []
    for side in ("one way", "the other way"):
        ready(f"turn the motor a little {side} by hand, let it return, and take the hand off")
        reading, count = motor_at_rest(stand)
        angles.append(reading)
        counts.append(0.0 if math.isnan(count) else count)
    value = 0.5 * (angles[0].mean + angles[1].mean)
    between = 0.5 * abs(angles[1].mean - angles[0].mean)
    uncertainty = math.hypot(
        between, counts[0] / math.sqrt(12.0), *(one.std / math.sqrt(one.readings) for one in angles)
    )
    zero = Zero(value, uncertainty)
    stored = _digits(zero.value, 9)
    update(
        path,
        {
            "stand": {"zero": stored},
            "calibration.zero": {"date": _now(), "zero": stored, "uncertainty": _digits(zero.uncertainty)},
        },
        joint or "",
    )
    return zero


def store_fixture(path: Path, recording: Path, *, joint: str | None = None, **search: Any) -> IdentificationResult:
    """Identify Kc and Bc of the empty rig from `recording` and store them in the stand file at `path`; return the
    result.

    joint: of a hand's file. search: further arguments of `hil.api.analysis.identify`. Raises WrongUse, and
    Untrustworthy if the recording does not determine the rig's stiffness.
    """
    load_stand(path, joint)
    result = identify([recording], "linear", **search)
    found = result.identification
    kc, bc = found["Kc"], found["Bc"]
    if not (found.trusted("Kc") and kc.value > 0.0):
        why = next((one.message for one in found.diagnostics if one.is_error), "it is as small as its noise")
        raise Untrustworthy(f"{recording} does not give the stiffness of the fixture, and nothing was stored: {why}")
    with Recording(recording) as opened:
        uid = str(opened.attributes.get("uid", ""))
    update(
        path,
        {
            "calibration.fixture": {
                "date": _now(),
                "recording": _beside(recording, path),
                "uid": uid,
                "stiffness": _digits(kc.value, 6),
                "stiffness_uncertainty": _digits(_error(kc.ci95)),
                "damping": _digits(bc.value, 6),
                "damping_uncertainty": _digits(_error(bc.ci95)),
            }
        },
        joint or "",
    )
    return result


def _beside(recording: Path, stand: Path) -> str:
    """Return the path of `recording`, relative to the folder of the stand file."""
    recording, folder = recording.resolve(), stand.resolve().parent
    return str(recording.relative_to(folder)) if recording.is_relative_to(folder) else str(recording)


def _error(ci95: tuple[float, float]) -> float:
    return (ci95[1] - ci95[0]) / 2.0 / _NORMAL


def _digits(value: float, digits: int = 4) -> float:
    """Return a value as a stand file takes it: rounding that exact readings leave is 0."""
    return float(f"{value:.{digits}g}") if abs(value) > 1e-15 else 0.0


def _now() -> datetime:
    return datetime.now(UTC).replace(microsecond=0)
