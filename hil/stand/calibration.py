"""[calibration] of the stand file: what `hil calibrate` measured, when, and how long it may be used."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from hil.diagnostics import Diagnostic

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Dated(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    date: datetime


class TorqueCalibration(_Dated):
    """[calibration.torque]: the cell's scale from known weights.

    scale: N m for one count or for a value of 1. uncertainty: of the scale, relative, one standard deviation.
    offset: what the cell showed without torque, in counts or as printed. hysteresis: N m between a load that was
    approached from below and from above; None if no load was hung both ways. residual: N m, root mean square.
    """

    scale: Positive
    uncertainty: NotNegative
    offset: Finite
    hysteresis: NotNegative | None = None
    residual: NotNegative
    points: Annotated[int, Field(ge=3)]


class StepCalibration(_Dated):
    """[calibration.step]: the cell's answer to a load that was taken off at once.

    delay: s, uncertainty: s, one standard deviation. bandwidth: Hz, at which a sine keeps 71 % of its swing.
    """

    delay: NotNegative
    uncertainty: NotNegative
    bandwidth: Positive


class FixtureCalibration(_Dated):
    """[calibration.fixture]: the stand without a joint. recording: of the empty rig, beside the stand file.

    stiffness: N m/rad, damping: N m s/rad, with their uncertainties, one standard deviation. uid: of the recording.
    """

    recording: str
    uid: str
    stiffness: Positive
    stiffness_uncertainty: NotNegative
    damping: Finite
    damping_uncertainty: NotNegative


class ZeroCalibration(_Dated):
    """[calibration.zero]: the motor angle at rest, `stand.zero`. zero, uncertainty (one standard deviation): rad."""

    zero: Finite
    uncertainty: NotNegative


class CalibrationTable(BaseModel):
    """[calibration]. valid_days: days after which a calibration counts as old."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    valid_days: Positive = 365.0
    torque: TorqueCalibration | None = None
    step: StepCalibration | None = None
    fixture: FixtureCalibration | None = None
    zero: ZeroCalibration | None = None

    def made(self) -> dict[str, datetime]:
        """Return the date of each calibration there is, by its name."""
        found = {name: getattr(self, name) for name in ("torque", "step", "fixture", "zero")}
        return {name: _in_utc(one.date) for name, one in found.items() if one is not None}

    def dates(self) -> dict[str, str]:
        """Return the same as texts, ISO 8601."""
        return {name: date.isoformat(timespec="seconds") for name, date in self.made().items()}

    def old(self, at: datetime) -> list[Diagnostic]:
        """Return a warning for each calibration that was older than `valid_days` at a time."""
        limit = timedelta(days=self.valid_days)
        return [
            Diagnostic(
                "calibration-old",
                f"the calibration of {name} was {(at - date).days} days old, more than calibration.valid_days = "
                f"{self.valid_days:g}: {_MEANING[name]}; repeat it with hil calibrate {_COMMAND[name]}",
            )
            for name, date in self.made().items()
            if at - date > limit
        ]


_MEANING = {
    "torque": "an error of its scale is the same error of Kc and Bc",
    "step": "1 ms of delay that is not known is about 10 % of the paper's Bc",
    "fixture": "its compliance is part of Kc and Bc where they are corrected by it",
    "zero": "the deflection may count from another angle",
}
_COMMAND = {"torque": "torque", "step": "torque --step", "fixture": "fixture", "zero": "zero"}


def _in_utc(date: datetime) -> datetime:
    return date.replace(tzinfo=UTC) if date.tzinfo is None else date.astimezone(UTC)
