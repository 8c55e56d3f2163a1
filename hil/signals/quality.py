"""How well a recording was made: what was lost, saturated, counted too coarsely or drowned in noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Status
from hil.diagnostics import Diagnostic
from hil.recording.reader import Recording
from hil.signals.prepare import Signals
from hil.signals.savitzky_golay import kernel, local_polynomial, widest

Array = NDArray[np.float64]

_FEW_COUNTS = 20.0  # counts of deflection, below which quantisation shapes the result
_POOR_SNR = 20.0  # dB
_MANY_LOST = 0.02
_MANY_SATURATED = 0.01
_GAIN_ERROR = 5e-3


@dataclass(frozen=True, slots=True)
class Quality:
    """samples: of the file. lost, saturated: rows of them. deflection: rad, peak to peak; deflection_lsb: rad, the
    smallest step seen. torque_noise: N m, standard deviation of what is left of the torque after a local polynomial.
    snr: dB, the torque's variance over that noise's; infinite without noise.
    """

    samples: int
    lost: int
    saturated: int
    deflection: float
    deflection_lsb: float
    torque_noise: float
    snr: float

    def diagnostics(self) -> list[Diagnostic]:
        """What is to be said of it."""
        counts, lost = self.deflection / self.deflection_lsb, self.lost / self.samples
        saturated, found = self.saturated / self.samples, []
        if lost > _MANY_LOST:
            found.append(Diagnostic("many-lost", f"{lost:.1%} of the replies were lost: check cable and baud rate"))
        if saturated > _MANY_SATURATED:
            found.append(
                Diagnostic(
                    "saturated",
                    f"the torque limit acted in {saturated:.1%} of the rows: lower --amplitude",
                )
            )
        if counts < _FEW_COUNTS:
            found.append(
                Diagnostic(
                    "few-counts",
                    f"the deflection spans {counts:.0f} counts of the encoder: raise --amplitude",
                    is_error=counts < 3.0,
                )
            )
        if self.snr < _POOR_SNR:
            found.append(
                Diagnostic(
                    "poor-snr",
                    f"the torque stands only {self.snr:.0f} dB above its noise: raise --amplitude",
                    is_error=self.snr < 3.0,
                )
            )
        return found


def assess(recording: Recording, signals: Signals) -> Quality:
    """The quality of a recording and of the signals that it gave."""
    status = recording.channel("status").astype(np.int64)
    noise = _noise(signals)
    return Quality(
        samples=len(recording),
        lost=signals.lost,
        saturated=int(np.count_nonzero(status & int(Status.SATURATED))),
        deflection=float(np.ptp(signals.dtheta)),
        deflection_lsb=_smallest_step(signals.dtheta),
        torque_noise=noise,
        snr=10.0 * float(np.log10(np.var(signals.torque) / noise**2)) if noise > 0.0 else float("inf"),
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
