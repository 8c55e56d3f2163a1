"""Summarise a recording: its rate, gaps, saturation, excited band and noise, and whether it can be used."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.diagnostics import Diagnostic
from hil.recording.ahead import Progress
from hil.recording.interval import Given
from hil.recording.reader import Recording
from hil.signals.constants import JITTER, PROBE
from hil.signals.prepare import prepare
from hil.signals.quality import assess, recording_diagnostics
from hil.signals.source import open_sources


@dataclass(frozen=True, slots=True)
class Inspection:
    """The summary of a recording.

    window: the first and the last time, s, if only a part was read. lateness: delay of the rows after their set-points'
    times, s: median, 99 % and largest, NaN if not stored. missed: number of skipped ticks. rate: median sampling rate,
    Hz. jitter: 99 % of the intervals differ from the median by no more than this, s. longest_gap: s. deflection, rad,
    and torque, N m: peak to peak. deflection_lsb: the smallest step between readings, rad. torque_noise: standard
    deviation of the torque about a local polynomial, N m. snr: ratio of the torque's variance to that noise's, dB.
    band: the excited band, Hz. rate_window: width of the window from which the rate is computed, s. calibrated: the
    dates, ISO 8601, of the calibrations in use, by name.
    """

    path: Path
    window: tuple[float, float] | None
    kind: str
    created: str
    end_reason: str
    samples: int
    duration: float
    rate: float
    jitter: float
    lost: int
    not_numbers: int
    longest_gap: float
    saturated: int
    late: int
    lateness: tuple[float, float, float]
    missed: int
    deflection: float
    deflection_lsb: float
    torque: float
    torque_noise: float
    snr: float
    band: tuple[float, float]
    rate_window: float
    torque_from: str
    calibrated: dict[str, str]
    diagnostics: tuple[Diagnostic, ...]

    @property
    def usable(self) -> bool:
        """Return whether there is no error among the diagnostics."""
        return not any(diagnostic.is_error for diagnostic in self.diagnostics)


def inspect(given: Given, progress: Progress | None = None) -> Inspection:
    """Summarise one recording, finished or not, or a part of it.

    progress: a function that is called with a phase and the fraction done, NaN if unknown. Raises WrongUse, and
    Untrustworthy if no signals can be computed.
    """
    with open_sources([given]) as (source,):
        source.verify(progress)
        recording = source.recording
        if progress is not None and len(recording) > PROBE:
            progress("computing the signals", math.nan)
        signals = prepare(recording, source.table)
        intervals = np.diff(signals.motion.time)
        read = recording.channel("read_time")
        stamps = np.where(np.isfinite(read), read, recording.channel("time"))
        stamps_read = stamps[np.isfinite(stamps) & np.isfinite(recording.channel("dtheta"))]
        stamps = stamps[np.isfinite(stamps)]
        quality = assess(recording, [signals], signals.defects)
        return Inspection(
            path=recording.path,
            window=recording.window,
            kind=str(recording.profile.get("kind", "unknown")),
            created=str(recording.attributes.get("created", "")),
            end_reason=str(recording.attributes.get("end_reason", "")) or "did not end",
            samples=len(recording),
            duration=float(stamps[-1] - stamps[0]),
            rate=1.0 / float(np.median(intervals)),
            jitter=float(np.quantile(np.abs(intervals - np.median(intervals)), JITTER)),
            lost=signals.defects.lost,
            not_numbers=signals.defects.not_numbers,
            longest_gap=float(np.diff(stamps_read).max()),
            saturated=quality.saturated,
            late=quality.late,
            lateness=(_stored(recording, "p50"), _stored(recording, "p99"), _stored(recording, "max")),
            missed=int(recording.attributes.get("missed", 0)),
            deflection=quality.deflection,
            deflection_lsb=quality.deflection_lsb,
            torque=float(np.ptp(signals.as_read)),
            torque_noise=quality.torque_noise,
            snr=quality.snr,
            band=signals.band,
            rate_window=signals.rate_window,
            torque_from=signals.torque_from,
            calibrated={} if source.stand is None else source.stand.calibration.dates(),
            diagnostics=tuple(recording_diagnostics(recording, quality, source.limits)),
        )


def _stored(recording: Recording, which: str) -> float:
    return float(recording.attributes.get(f"lateness_{which}", np.nan))
