"""[calibration] of the stand file: the values that `hil calibrate` measured, their dates, and how long they are
valid.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from hil.diagnostics import Diagnostic

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


def _in_utc(date: datetime) -> datetime:
    """Return the date in UTC; a date without a time zone counts as UTC. Raises ValueError for a year that UTC cannot
    have.
    """
    try:
        return date.replace(tzinfo=UTC) if date.tzinfo is None else date.astimezone(UTC)
    except OverflowError:
        raise ValueError(f"{date} is no date of a calibration") from None


class _Dated(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    date: Annotated[datetime, AfterValidator(_in_utc)]


class TorqueCalibration(_Dated):
    """[calibration.torque]: the torque cell's scale, from known weights.

    scale: N m for one count or for a printed value of 1. uncertainty: relative standard uncertainty of the scale.
    offset: the cell's reading without torque, in counts or as printed. hysteresis: difference, N m, between the same
    load approached from below and from above; None if no load was hung both ways. residual: root mean square of the
    fit's residuals, N m. points: number of loads.
    """

    scale: Positive
    uncertainty: NotNegative
    offset: Finite
    hysteresis: NotNegative | None = None
    residual: NotNegative
    points: Annotated[int, Field(ge=3)]


class StepCalibration(_Dated):
    """[calibration.step]: the torque cell's response to a load that was taken off suddenly.

    delay: s. uncertainty: standard uncertainty of the delay, s. bandwidth: frequency, Hz, at which a sine keeps 71 % of
    its amplitude.
    """

    delay: NotNegative
    uncertainty: NotNegative
    bandwidth: Positive


class FixtureCalibration(_Dated):
    """[calibration.fixture]: stiffness and damping of the stand without a joint.

    recording: path of the recording of the empty rig, relative to the stand file. uid: of that recording. stiffness: N
    m/rad. damping: N m s/rad. stiffness_uncertainty, damping_uncertainty: standard uncertainties, in the same units.
    """

    recording: str
    uid: str
    stiffness: Positive
    stiffness_uncertainty: NotNegative
    damping: Finite
    damping_uncertainty: NotNegative


class ZeroCalibration(_Dated):
    """[calibration.zero]: the motor's angle at rest. zero: the angle, rad, as in `stand.zero`. uncertainty: standard
    uncertainty, rad.
    """

    zero: Finite
    uncertainty: NotNegative


class CalibrationTable(BaseModel):
    """[calibration]: all calibrations of the stand. valid_days: number of days after which a calibration is reported as
    old.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    valid_days: Annotated[Positive, Field(le=1e5)] = 365.0
    torque: TorqueCalibration | None = None
    step: StepCalibration | None = None
    fixture: FixtureCalibration | None = None
    zero: ZeroCalibration | None = None

    def made(self) -> dict[str, datetime]:
        """Return the date of each calibration in the file, by the calibration's name."""
        found = {name: getattr(self, name) for name in ("torque", "step", "fixture", "zero")}
        return {name: one.date for name, one in found.items() if one is not None}

    def dates(self) -> dict[str, str]:
        """Return the date of each calibration in the file as a text (ISO 8601), by the calibration's name."""
        return {name: date.isoformat(timespec="seconds") for name, date in self.made().items()}

    def old(self, at: datetime) -> list[Diagnostic]:
        """Return a warning for each calibration that was older than `valid_days` days at the time `at`."""
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
