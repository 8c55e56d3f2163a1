"""Compute the dynamic stiffness G = K' + i 2 pi f B' of a joint without a model: stiffness and damping in bands of
frequency.

Torque and deflection are cut into overlapping segments. G is the quotient of their cross spectra with an instrument,
summed over the segments and the lines of a band (Pintelon and Schoukens, System Identification, 2012, section 2.7). If
the commanded deflection was recorded, it is the instrument, because its errors are independent of those of the
readings; otherwise the instrument is the deflection itself, whose noise makes K' too low. Within a band K' and B' are
assumed constant. Damping is computed from the measured rate and not from i 2 pi f times the deflection, so that the
window does not distort a spring and damper. Intervals come from the scatter of the lines about G. Lines are weighted as
the independent data that remain with Hann's window and the overlap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil.signals import constants as c
from hil.uncertainty.effects import Recorded

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Bands:
    """Stiffness, N m/rad, and damping, N m s/rad, in b bands, each (b,) with half its 95 % interval.

    frequency (b,): mean frequency of each band, Hz. coherence (b,): the fraction, 0 to 1, of the torque's power in the
    band that follows from the deflection. deflection: r.m.s. deflection over the segments, rad.
    """

    frequency: Array
    stiffness: Array
    stiffness_half_width: Array
    damping: Array
    damping_half_width: Array
    coherence: Array
    deflection: float


@dataclass(frozen=True, slots=True)
class Distortion:
    """The harmonic distortion of a periodic recording.

    level: the torque at frequencies that the excitation does not contain, r.m.s., relative to the whole torque. noise:
    the same ratio for the differences between periods. period: the period of the excitation, s.
    """

    level: float
    noise: float
    period: float


@dataclass(frozen=True, slots=True)
class DynamicStiffness:
    """The dynamic stiffness of a joint.

    bands: the bands of all segments. by_amplitude: the bands of the half of the segments with the smaller deflection,
    and of the half with the larger one; () if the deflections are equal. instrument: "command" or "deflection".
    distortion: None if the excitation is not periodic, or has power at every frequency.
    """

    bands: Bands
    by_amplitude: tuple[Bands, ...]
    instrument: str
    distortion: Distortion | None

    @property
    def groups(self) -> list[tuple[str, Bands]]:
        """Return the bands with the name of their segments: "all", and "small" and "large" for those of small and large
        deflection.
        """
        return [("all", self.bands), *zip(("small", "large"), self.by_amplitude, strict=False)]


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Spectra of each segment (s, l) at frequencies (l,), Hz: of torque, angle, rate and instrument.

    deflection (s,): r.m.s. deflection of each segment, rad.
    """

    frequency: Array
    torque: Complex
    moved: Complex
    rate: Complex
    instrument: Complex
    deflection: Array

    def of(self, segments: NDArray[np.bool_]) -> _Spectra:
        return _Spectra(
            self.frequency,
            self.torque[segments],
            self.moved[segments],
            self.rate[segments],
            self.instrument[segments],
            self.deflection[segments],
        )


def dynamic_stiffness(
    recorded: Recorded, band: tuple[float, float], command: Array | None = None
) -> DynamicStiffness | None:
    """Return the dynamic stiffness in a band, Hz; None if the recording is shorter than a segment.

    band: the excited band of the motion. command (n,): set-points, rad or N m, in the order of the samples. The command
    is ignored if it has gaps, is constant, or the motion does not follow it.
    """
    usable = command is not None and bool(np.isfinite(command).all()) and float(np.ptp(command)) > 0.0
    instrument = command if command is not None and usable else recorded.deflection
    spectra = _spectra(recorded, instrument, band)
    if spectra is None:
        return None
    if usable and not _follows(spectra, band):
        usable, spectra = False, replace(spectra, instrument=spectra.moved)
    bands = _in_bands(spectra, band, spectra)
    if not bands.frequency.size:
        return None
    return DynamicStiffness(
        bands=bands,
        by_amplitude=_by_amplitude(spectra, band),
        instrument="command" if usable else "deflection",
        distortion=_distortion(recorded, band, bands),
    )


def _even(recorded: Recorded, part: slice, values: Array) -> Array:
    """Return the values of one piece on an even time grid."""
    time = recorded.time[part]
    count = 1 + round(float(time[-1] - time[0]) / recorded.step)
    return np.interp(np.linspace(time[0], time[-1], count), time, values[part])


def _spectra(recorded: Recorded, instrument: Array, band: tuple[float, float]) -> _Spectra | None:
    step = recorded.step
    length = min(round(c.CYCLES / (band[0] * step)), 2 * len(recorded) // (c.SEGMENTS + 1))
    if length < c.SHORTEST_SEGMENT:
        return None
    window = np.hanning(length + 1)[:-1]
    found: list[list[Array]] = []
    for part in recorded.stretches():
        if part.stop - part.start < length:
            continue
        four = (recorded.torque, recorded.deflection, recorded.rate, instrument)
        even = [_even(recorded, part, values) for values in four]
        for first in range(0, len(even[0]) - length + 1, length // 2):
            cut = [values[first : first + length] for values in even]
            found.append([one - one.mean() for one in cut])
    if len(found) < c.SEGMENTS // 2:
        return None
    segments = np.array(found)
    lines = np.fft.rfft(segments * window, axis=2)
    deflection = np.sqrt(np.mean(segments[:, 1] ** 2, axis=1))
    frequency = np.asarray(np.fft.rfftfreq(length, step), dtype=np.float64)
    torque, moved, rate, instrumental = np.moveaxis(lines, 1, 0)
    return _Spectra(frequency, torque, moved, rate, instrumental, np.asarray(deflection))


def _edges(frequency: Array, band: tuple[float, float]) -> NDArray[np.int64]:
    """Return the edges of the bands, in lines of the spectrum: in equal ratios, each band wider than a main lobe."""
    low, high = np.searchsorted(frequency, band)
    first = max(1, int(low) - 2)
    last = max(int(high) + 2, first + c.MAIN_LOBE)
    ideal = np.geomspace(first, last, c.BANDS + 1)
    edges = [first]
    for edge in ideal[1:]:
        if round(edge) - edges[-1] >= c.MAIN_LOBE:
            edges.append(round(edge))
    edges[1 if len(edges) == 1 else -1 :] = [last]
    return np.array(edges)


def _follows(spectra: _Spectra, band: tuple[float, float]) -> bool:
    """Return whether the deflection follows the instrument, through the same filter in all segments."""
    edges = _edges(spectra.frequency, band)
    moved, instrument = (one[:, edges[0] : edges[-1]] for one in (spectra.moved, spectra.instrument))
    own = np.sum(np.abs(instrument) ** 2, axis=0)
    common = np.abs(np.sum(moved * np.conj(instrument), axis=0)) ** 2 / np.maximum(own, 1e-300)
    return float(common.sum()) > c.FOLLOWS * float(np.sum(np.abs(moved) ** 2))


def _in_bands(spectra: _Spectra, band: tuple[float, float], every: _Spectra) -> Bands:
    """Return the bands of some segments, without the bands in which these segments hardly moved.

    every: the spectra of all segments, with which the motion is compared: compared with segments at rest, noise would
    look like motion.
    """
    edges = _edges(spectra.frequency, band)
    inside = slice(int(edges[0]), int(edges[-1]))
    least = [
        share * _power(lines, inside)
        for lines, share in ((every.moved, c.WEAK_BAND), (every.instrument, c.EMPTY_BAND), (every.torque, c.EMPTY_BAND))
    ]
    rows = []
    for first, last in pairwise(edges.tolist()):
        lines = slice(first, last)
        powers = [_power(one, lines) for one in (spectra.moved, spectra.instrument, spectra.torque)]
        if all(power > limit for power, limit in zip(powers, least, strict=True)):
            rows += _band(spectra, lines)
    frequency, stiffness, of_stiffness, damping, of_damping, coherence = np.array(rows).reshape(-1, 6).T
    moved = float(np.sqrt(np.mean(spectra.deflection**2)))
    return Bands(frequency, stiffness, of_stiffness, damping, of_damping, coherence, moved)


def _power(lines: Complex, some: slice) -> float:
    """Return the mean power of the lines (s, l) that `some` selects; 0 if it selects none."""
    chosen = lines[:, some]
    return float(np.mean(np.abs(chosen) ** 2)) if chosen.size else 0.0


def _band(spectra: _Spectra, lines: slice) -> list[tuple[float, ...]]:
    """Return frequency (Hz), K', half the interval of K', B', half the interval of B', and coherence; [] if K' and B'
    cannot be separated.
    """
    from scipy.special import stdtrit

    torque, moved, rate = spectra.torque[:, lines], spectra.moved[:, lines], spectra.rate[:, lines]
    weights = np.conj(spectra.instrument[:, lines])
    total, turning = (moved * weights).sum(), (rate * weights).sum()
    right = (torque * weights).sum()
    apart = abs(total.real * turning.imag - total.imag * turning.real)
    if not apart > c.ALIGNED * abs(total) * abs(turning):
        return []
    system = np.array([[total.real, turning.real], [total.imag, turning.imag]])
    stiffness, damping = np.linalg.solve(system, [right.real, right.imag]).tolist()
    left = torque - stiffness * moved - damping * rate
    scores = np.abs(left * weights / abs(total)) ** 2
    variance = float(scores.sum()) / 2.0 * c.ALIKE
    freedom = max(1.0, float(scores.sum() ** 2 / max(float((scores**2).sum()), 1e-300)) * 2.0 / c.ALIKE - 2.0)
    half = float(stdtrit(freedom, c.UPPER)) * np.sqrt(variance * freedom / max(freedom - 1.0, 0.5))
    mean_speed = float(abs(turning / total))
    coherence = 1.0 - float(np.sum(np.abs(left) ** 2)) / float(np.sum(np.abs(torque) ** 2))
    return [(mean_speed / (2.0 * np.pi), stiffness, half, damping, half / mean_speed, max(0.0, coherence))]


def _by_amplitude(spectra: _Spectra, band: tuple[float, float]) -> tuple[Bands, ...]:
    """Return the bands of the half of the moving segments with the smaller deflection, and of the half with the larger
    one.

    () if the deflections are equal.
    """
    moving = spectra.deflection**2 > c.WEAK_BAND * np.mean(spectra.deflection**2)
    large = moving & (spectra.deflection > np.median(spectra.deflection[moving]))
    small = moving & ~large
    if not large.any() or spectra.deflection[large].mean() < c.TWO_AMPLITUDES * spectra.deflection[small].mean():
        return ()
    found = tuple(_in_bands(spectra.of(chosen), band, spectra) for chosen in (small, large))
    return found if all(bands.frequency.size for bands in found) else ()


def _distortion(recorded: Recorded, band: tuple[float, float], bands: Bands) -> Distortion | None:
    """Return the harmonic distortion, from the repeating periods of the longest piece.

    None if too few periods repeat, as with a growing or fading amplitude, and if no frequency is free of motion.
    """
    part = max(recorded.stretches(), key=lambda one: one.stop - one.start)
    torque, moved = (_even(recorded, part, values) for values in (recorded.torque, recorded.deflection))
    for samples in _periods(moved, int(0.5 / (band[1] * recorded.step))):
        if (cut := _repeating(torque, moved, samples)) is not None:
            return _distorted(*cut, samples * recorded.step, band, bands)
    return None


def _repeating(torque: Array, moved: Array, samples: float) -> tuple[Array, Array] | None:
    """Return torque and deflection (k, n) of the k periods of `samples` samples that repeat; None if too few do."""
    count, length = int(len(moved) / samples + 0.01), int(samples)
    grid = np.arange(count * length) * (samples / length)
    cut = [np.interp(grid, np.arange(len(moved)), values).reshape(count, length) for values in (torque, moved)]
    energy = np.sum((cut[1] - cut[1].mean()) ** 2, axis=1)
    usual = np.quantile(energy, 0.75)  # fades take energy away, in two of four periods
    steady = np.abs(energy - usual) < c.STEADY * usual
    if np.count_nonzero(steady) < max(c.REPEATED, count / 2):
        return None
    apart = cut[1][steady] - cut[1][steady].mean(axis=0)
    if np.sum(apart**2) > (1.0 - c.PERIODIC) * np.sum(energy[steady]):
        return None
    return cut[0][steady], cut[1][steady]


def _distorted(
    torque: Array, moved: Array, period: float, band: tuple[float, float], bands: Bands
) -> Distortion | None:
    """Return the harmonic distortion of the torque (k, n), for periods of `period` s; None if no frequency is free of
    motion.
    """
    repeated, length = torque.shape
    lines = [np.fft.rfft(one, axis=1) for one in (torque, moved)]
    frequency = np.fft.rfftfreq(length, period / length)
    speed = 2j * np.pi * frequency
    joined = (
        np.interp(frequency, bands.frequency, bands.stiffness),
        np.interp(frequency, bands.frequency, bands.damping),
    )
    left = lines[0] - (joined[0] + speed * joined[1]) * lines[1]
    mean, size = left.mean(axis=0), np.abs(lines[1].mean(axis=0))
    noise = np.var(left, axis=0, ddof=1) / repeated
    looked = (frequency > 0.0) & (frequency < c.HARMONICS * band[1]) & (size < c.EXCITED * size[1:].max())
    if not looked.any():
        return None
    whole = float(np.sum(np.abs(lines[0].mean(axis=0)[1:]) ** 2))
    power, chance = float(np.sum(np.abs(mean[looked]) ** 2)), float(noise[looked].sum())
    return Distortion(
        level=float(np.sqrt(max(0.0, power - chance) / whole)),
        noise=float(np.sqrt(chance / whole)),
        period=period,
    )


def _periods(values: Array, shortest: int) -> list[float]:
    """Return candidates for the period, in samples, not rounded: the first and the highest maximum of the
    autocorrelation.

    If the amplitude changes slowly, values are similar before a whole period has passed.
    """
    centred = values - values.mean()
    count = len(values)
    size = 1 << int(np.ceil(np.log2(2 * count)))
    products = np.fft.irfft(np.abs(np.fft.rfft(centred, size)) ** 2)[: count // 2 + 2]
    squares = np.concatenate([[0.0], np.cumsum(centred**2)])
    lags = np.arange(len(products))
    energy = np.sqrt(squares[count - lags] * (squares[-1] - squares[lags]))
    similar = products / np.maximum(energy, 1e-300)
    peaks = 1 + np.flatnonzero(
        (similar[1:-1] >= similar[:-2]) & (similar[1:-1] > similar[2:]) & (similar[1:-1] > c.FADING)
    )
    peaks = peaks[peaks > shortest]
    alike = peaks[similar[peaks] > c.PERIODIC][:1].tolist()
    most = peaks[np.argsort(-similar[peaks])][:1].tolist()
    found = []
    for at in dict.fromkeys(alike + most):
        before, here, after = similar[at - 1 : at + 2].tolist()
        bend = before - 2.0 * here + after
        found.append(at + 0.5 * (before - after) / bend if bend < 0.0 else float(at))
    return found
