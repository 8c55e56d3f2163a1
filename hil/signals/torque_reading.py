"""Recognise a filter, a resampling or a delay of the torque from its readings alone.

A torque reading that was processed in this way is not the torque of the coupling, and no model of the coupling
describes it. The part of the torque that no linear filter of the deflection explains is noise, and the noise passes
through the same processing: a moving mean removes the multiples of one frequency, a curve through the readings of a
slower cell removes everything above half the cell's rate. A median filter repeats a reading now and then, a slow cell
repeats all its readings. The delay is the one at which torque and deflection agree best.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.signals.prepare import Signals

Array = NDArray[np.float64]

_SEGMENT: Final = 1024  # samples of a segment of the spectrum, at most
_SEGMENTS: Final = 8  # of that length at least that must fit
_BEYOND: Final = 1.3  # times the upper end of the band, from where the torque is mostly noise
_WHOLE: Final = 0.48  # of the sampling rate, up to where a spectrum is looked at
_CLIFF: Final = 1e3  # of power lost within an octave, which a filter of the fourth order does not reach
_EDGE: Final = 10.0  # of power lost, where the cliff begins
_FALLS: Final = 0.1  # of the power an octave above a cliff, that is left at the end of the spectrum
_NOTHING: Final = 1e-6  # of the power in the band, that is no noise
_GAPS: Final = -1.0  # decades of power by which each gap of a moving mean is below what is beside it
_SHALLOW: Final = -0.3  # the same of the direction of the motion, whose gaps friction has, beside noise that fills them
_LOBES: Final = 0.8  # decades of power, by which those between the gaps differ from a mean's
_LONGEST_MEAN: Final = 120  # readings
_REPEATS: Final = 0.03  # part of the readings, from which they are no chance
_LATEST: Final = 0.2  # s, that a torque may be late
_LATE: Final = 0.5  # of the power that is left, which a delay must explain
_FINE: Final = 40.0  # delays that are tried in the shortest period


def seen_in_torque(signals: Signals, longest: float) -> str:
    """Return, as text, which filter, resampling or delay the torque has, and the remedy; "" if none is detected.

    longest: the longest delay, s, that the models of the coupling describe.
    """
    torque, motion = signals.as_read, signals.motion
    step = float(np.median(np.diff(motion.time)))
    if signals.slower or motion.part_of is not None or len(motion.starts) > 1:
        return ""
    if float(np.mean(np.diff(torque) == 0.0)) > _REPEATS and len(np.unique(torque)) > len(torque) // 2:
        return (
            "single readings of the torque repeat, which is typical of a median filter. No model corrects such a "
            "filter, so Bc may be wrong. Switch it off"
        )
    found = _seen_in_noise(signals, step)
    if found:
        return found
    late = _delay(signals, step)
    if late <= longest:
        return ""
    return (
        f"the torque reading is {1e3 * late:.3g} ms late, and a model corrects at most {1e3 * longest:.2g} ms. "
        "Subtract the delay from the time stamps of the torque, or find what delays its readings"
    )


def _seen_in_noise(signals: Signals, step: float) -> str:
    """Return, as text, the resampling or moving mean that the noise of the torque shows; "" if there is none."""
    length = min(_SEGMENT, len(signals) // _SEGMENTS)
    frequency, power = _noise_spectrum(signals.as_read, signals.motion.dtheta, length, step)
    looked = (frequency > _BEYOND * signals.band[1]) & (frequency < _WHOLE / step)
    if np.count_nonzero(looked) <= _SEGMENTS:
        return ""
    if (edge := _cliff(frequency[1:], power[1:], signals.band[1])) is not None:
        return (
            f"the torque has nothing above {edge:.3g} Hz, not even noise: a smooth curve joins the readings of a cell "
            f"of about {2.0 * edge:.3g} Hz. Record these readings with their own time stamps"
        )
    count = _mean_of(frequency[looked], power[looked], step)
    if count is not None and not _turns_lack(signals, length, step, frequency[looked], count):
        return (
            f"the noise of the torque lacks the multiples of {1.0 / (count * step):.3g} Hz: each reading is the mean "
            f"of {count} and {1e3 * 0.5 * (count - 1) * step:.3g} ms late. Switch the mean off, or pass the angle "
            "through the same mean. Where the table was interpolated from fewer readings, import those"
        )
    return ""


def _noise_spectrum(torque: Array, angle: Array, length: int, step: float) -> tuple[Array, Array]:
    """Return frequencies (l,), Hz, and power (l,) of the torque that no linear filter of the deflection explains."""
    tau, moved = _spectra(torque, length), _spectra(angle, length)
    own = (np.abs(moved) ** 2).sum(axis=0)
    common = np.abs((tau * moved.conj()).sum(axis=0)) ** 2 / np.maximum(own, 1e-300)
    power = np.maximum((np.abs(tau) ** 2).sum(axis=0) - common, 0.0)
    frequency = np.asarray(np.fft.rfftfreq(length, step), dtype=np.float64)
    return frequency, _smoothed(power)


def _spectra(values: Array, length: int) -> NDArray[np.complex128]:
    """Return the spectra (pieces, l) of half-overlapping pieces of the values (n,)."""
    firsts = np.arange(0, len(values) - length + 1, length // 2)
    pieces = values[firsts[:, None] + np.arange(length)]
    return np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * np.hanning(length + 1)[:-1])


def _smoothed(power: Array) -> Array:
    return np.convolve(power, np.full(3, 1.0 / 3.0), mode="same")


def _turns_lack(signals: Signals, length: int, step: float, frequency: Array, count: int) -> bool:
    """Return whether the motion, or its direction, itself lacks the frequencies that a mean of `count` readings
    removes.

    Both lack these frequencies if a drive rings, or takes set-points, at that pace. The torque of friction has the
    spectrum of the direction and is no noise; nor is the torque of a ripple too fast to be sampled.
    """
    for values in (np.sign(signals.motion.dtheta_dot), signals.motion.dtheta):
        spectra = _spectra(values, length)
        power = np.interp(frequency, np.fft.rfftfreq(length, step), _smoothed((np.abs(spectra) ** 2).sum(axis=0)))
        _, depths, _ = _gaps(frequency, _decades(power), count, step)
        if np.median(depths) < _SHALLOW:
            return True
    return False


def _decades(power: Array) -> Array:
    return np.log10(np.maximum(power, 1e-300))


def _gaps(frequency: Array, decades: Array, count: int, step: float) -> tuple[Array, Array, Array]:
    """Return the gaps in the spectrum that a mean of `count` readings would cause.

    The results are their frequencies (g,), Hz, their depths (g,) in decades, and the power of the lobe after each gap.
    decades: the spectrum's power as a logarithm.
    """
    half = 0.5 / (count * step)
    gaps = 2.0 * half * np.arange(1, count)
    gaps = gaps[(gaps - half > frequency[0]) & (gaps + half < frequency[-1])]
    before, at, after = (np.interp(gaps + shift, frequency, decades) for shift in (-half, 0.0, half))
    return gaps, at - 0.5 * (before + after), after + 2.0 * np.log10(np.sin(np.pi * (gaps + half) * step))


def _cliff(frequency: Array, power: Array, highest: float) -> float | None:
    """Return the frequency, Hz, above which the torque has no noise; None if there is noise at all frequencies."""
    below = power[frequency < _BEYOND * highest]
    usual = float(np.median(below)) if below.size else 0.0
    gone = np.flatnonzero((power < usual / _EDGE) & (frequency > highest))
    for first in frequency[gone[:1]].tolist():
        above = power[(frequency > 1.8 * first) & (frequency < 2.2 * first)]
        octave = float(np.median(above)) if above.size else np.inf
        last = float(np.median(power[-len(power) // 3 :]))
        # harmonics of a law that bends end too, but in noise, which does not fall any further
        is_noise = last > _FALLS * octave and octave > _NOTHING * usual
        if octave < usual / (_EDGE * _CLIFF) and not is_noise:
            return float(first)
    return None


def _mean_of(frequency: Array, power: Array, step: float) -> int | None:
    """Return the length of a moving mean, in readings, computed from the gaps in the noise's spectrum; None if there
    are no gaps.
    """
    found, lobes = None, np.zeros(1)
    for count in range(3, _LONGEST_MEAN):
        gaps, depths, between = _gaps(frequency, _decades(power), count, step)
        if gaps.size and (depths < _GAPS).all():
            found, lobes = count, between  # the longest: a divisor of it has a part of the gaps
    return found if np.ptp(lobes) < _LOBES else None


def _delay(signals: Signals, step: float) -> float:
    """Return the delay of the torque, s, if spring and damper explain the torque much better with that delay; else
    0.
    """
    motion, torque = signals.motion, signals.torque
    columns = np.stack([motion.dtheta, motion.dtheta_dot, np.ones(len(motion))], axis=1)
    pace = max(step, 1.0 / (_FINE * signals.band[1]))
    most = min(int(_LATEST / pace), len(torque) // (4 * max(1, round(pace / step))))
    tried = pace * np.arange(most + 1)
    inside = slice(int(_LATEST / step) + 1, None)

    def left(delay: float) -> float:
        shift = round(delay / step)
        then = columns[inside.start - shift : len(columns) - shift]
        found = torque[inside]
        return float(np.sum((found - then @ np.linalg.lstsq(then, found, rcond=None)[0]) ** 2))

    if len(torque[inside]) < 8 * columns.shape[1]:
        return 0.0
    rest = np.array([left(delay) for delay in tried.tolist()])
    return float(tried[np.argmin(rest)]) if rest.min() < _LATE * rest[0] else 0.0
