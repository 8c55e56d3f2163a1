"""Whether a recording can be used: its rate, gaps, saturation, excitation and noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Status
from hil.dataset import recording_findings, stand_of
from hil.errors import Untrustworthy
from hil.findings import Finding, lateness
from hil.local_polynomial import kernel, local_polynomial, widest
from hil.signals import Signals, prepare
from hil.store import Recording

Array = NDArray[np.float64]

_FEW_COUNTS = 20.0  # counts of deflection, below which quantisation shapes the result
_POOR_SNR = 20.0  # dB
_MANY_LOST = 0.02
_MANY_SATURATED = 0.01
_GAIN_ERROR = 5e-3


@dataclass(frozen=True, slots=True)
class Inspection:
    """What a recording holds.

    rate Hz (median), jitter s (99 % of the intervals are within it of the median), longest_gap s, deflection rad and
    torque N m (peak to peak), deflection_lsb rad (smallest step seen), torque_noise N m (standard deviation of what is
    left of the torque after a local cubic), snr dB (torque's variance over that noise's), band Hz, rate_window s.
    """

    path: Path
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
    deflection: float
    deflection_lsb: float
    torque: float
    torque_noise: float
    snr: float
    band: tuple[float, float]
    rate_window: float
    torque_from: str
    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        """Whether nothing fatal was found."""
        return not any(finding.fatal for finding in self.findings)


def inspect(path: Path) -> Inspection:
    """Look at one recording, finished or not. Raises WrongUse, and Untrustworthy where there is nothing to measure."""
    with Recording(path) as recording:
        if not recording.verify():
            raise Untrustworthy(f"{path}: the samples are not the ones that were written (sha256 differs)")
        signals = prepare(recording, stand_of(recording))
        status = recording.channel("status").astype(np.int64)
        saturated = int(np.count_nonzero(status & int(Status.SATURATED)))
        late = int(np.count_nonzero(status & int(Status.LATE)))
        intervals = np.diff(signals.time)
        read = recording.channel("read_time")
        stamps = np.where(np.isfinite(read), read, recording.channel("time"))
        stamps = stamps[np.isfinite(stamps)]
        noise = _noise(signals)
        snr = 10.0 * float(np.log10(np.var(signals.torque) / noise**2)) if noise > 0.0 else float("inf")
        measured = {
            "lost": signals.lost / len(recording),
            "saturated": saturated / len(recording),
            "counts": float(np.ptp(signals.dtheta)) / _smallest_step(signals.dtheta),
            "snr": snr,
        }
        return Inspection(
            path=path,
            kind=str(recording.profile.get("kind", "unknown")),
            created=str(recording.attributes.get("created", "")),
            end_reason=str(recording.attributes.get("end_reason", "")) or "did not end",
            samples=len(recording),
            duration=float(stamps[-1] - stamps[0]),
            rate=1.0 / float(np.median(intervals)),
            jitter=float(np.quantile(np.abs(intervals - np.median(intervals)), 0.99)),
            lost=signals.lost,
            not_numbers=signals.not_numbers,
            longest_gap=float(intervals.max()),
            saturated=saturated,
            late=late,
            deflection=float(np.ptp(signals.dtheta)),
            deflection_lsb=_smallest_step(signals.dtheta),
            torque=float(np.ptp(signals.torque)),
            torque_noise=noise,
            snr=snr,
            band=signals.band,
            rate_window=signals.rate_window,
            torque_from=signals.torque_from,
            findings=tuple(
                recording_findings(recording, signals) + _quality(measured) + lateness(late, len(recording))
            ),
        )


def _noise(signals: Signals) -> float:
    """Standard deviation of the torque, N m, about a local polynomial over what moved; robust to outliers."""
    time = signals.time
    cycles = signals.band[1] * (time[-1] - time[0]) / (len(time) - 1)
    half = widest(0, cycles, max(2, (len(time) - 1) // 8), _GAIN_ERROR)
    left = signals.torque - local_polynomial(time, signals.torque, half)[0]
    return 1.4826 * float(np.median(np.abs(left))) / float(np.sqrt(1.0 - kernel(half, 0)[half]))


def _smallest_step(values: Array) -> float:
    """The smallest difference between two readings that is more than rounding."""
    steps = np.diff(np.unique(values))
    return float(steps[steps > 1e-9 * np.ptp(values)].min())


def _quality(measured: dict[str, float]) -> list[Finding]:
    found = []
    if measured["lost"] > _MANY_LOST:
        found.append(
            Finding("many-lost", f"{measured['lost']:.1%} of the replies were lost: check cable and baud rate")
        )
    if measured["saturated"] > _MANY_SATURATED:
        found.append(
            Finding(
                "saturated", f"the torque limit acted in {measured['saturated']:.1%} of the rows: lower --amplitude"
            )
        )
    if measured["counts"] < _FEW_COUNTS:
        found.append(
            Finding(
                "few-counts",
                f"the deflection spans {measured['counts']:.0f} counts of the encoder: raise --amplitude",
                fatal=measured["counts"] < 3.0,
            )
        )
    if measured["snr"] < _POOR_SNR:
        found.append(
            Finding(
                "poor-snr",
                f"the torque stands only {measured['snr']:.0f} dB above its noise: raise --amplitude",
                fatal=measured["snr"] < 3.0,
            )
        )
    return found
