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

import numpy as np
from numpy.typing import NDArray

from ga.arrays import Array, Index
from ga.model.trajectory import Motion
from hil.identification.deflection.instruments import is_instrument
from hil.signals import constants as c

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class DynamicStiffness:
    """Stiffness, N m/rad, and damping, N m s/rad, in b bands, each (b,) with half its 95 % interval.

    frequency (b,): mean frequency of each band, Hz. coherence (b,): the fraction, 0 to 1, of the torque's power in the
    band that follows from the deflection. deflection: r.m.s. deflection over the segments, rad. instrument: "command"
    or "deflection".
    """

    frequency: Array
    stiffness: Array
    stiffness_half_width: Array
    damping: Array
    damping_half_width: Array
    coherence: Array
    deflection: float
    instrument: str


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Spectra of each segment (s, l) at frequencies (l,), Hz: of torque, angle, rate and instrument.

    deflection: r.m.s. deflection over the segments, rad.
    """

    frequency: Array
    torque: Complex
    moved: Complex
    rate: Complex
    instrument: Complex
    deflection: float


def dynamic_stiffness(
    motion: Motion, torque: Array, band: tuple[float, float], command: Array | None = None
) -> DynamicStiffness | None:
    """Return the dynamic stiffness in a band, Hz; None if the recording is shorter than a segment.

    torque (n,): of the coupling, N m. band: the excited band of the motion. command (n,): set-points, rad or N m, in
    the order of the samples. The command is ignored if it has gaps, is constant, or the motion does not follow it.
    """
    usable = is_instrument(command)
    instrument = command if command is not None and usable else motion.dtheta
    spectra = _spectra(motion, torque, instrument, band)
    if spectra is None:
        return None
    if usable and not _follows(spectra, band):
        usable, spectra = False, replace(spectra, instrument=spectra.moved)
    rows = _in_bands(spectra, band)
    if not rows:
        return None
    frequency, stiffness, of_stiffness, damping, of_damping, coherence = np.array(rows).T
    bands = (frequency, stiffness, of_stiffness, damping, of_damping, coherence)
    return DynamicStiffness(*bands, spectra.deflection, "command" if usable else "deflection")


def _even(motion: Motion, part: slice, values: Array) -> Array:
    """Return the values of one piece on an even time grid."""
    time = motion.time[part]
    count = 1 + round(float(time[-1] - time[0]) / motion.step)
    return np.interp(np.linspace(time[0], time[-1], count), time, values[part])


def _spectra(motion: Motion, torque: Array, instrument: Array, band: tuple[float, float]) -> _Spectra | None:
    step = motion.step
    length = min(round(c.CYCLES / (band[0] * step)), 2 * len(motion) // (c.SEGMENTS + 1))
    if length < c.SHORTEST_SEGMENT:
        return None
    window = np.hanning(length + 1)[:-1]
    found: list[list[Array]] = []
    for part in motion.pieces:
        if part.stop - part.start < length:
            continue
        four = (torque, motion.dtheta, motion.dtheta_dot, instrument)
        even = [_even(motion, part, values) for values in four]
        for first in range(0, len(even[0]) - length + 1, length // 2):
            cut = [values[first : first + length] for values in even]
            found.append([one - one.mean() for one in cut])
    if len(found) < c.SEGMENTS // 2:
        return None
    segments = np.array(found)
    lines = np.fft.rfft(segments * window, axis=2)
    deflection = float(np.sqrt(np.mean(segments[:, 1] ** 2)))
    frequency = np.asarray(np.fft.rfftfreq(length, step), dtype=np.float64)
    of_torque, moved, rate, instrumental = np.moveaxis(lines, 1, 0)
    return _Spectra(frequency, of_torque, moved, rate, instrumental, deflection)


def _edges(frequency: Array, band: tuple[float, float]) -> Index:
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


def _in_bands(spectra: _Spectra, band: tuple[float, float]) -> list[tuple[float, ...]]:
    """Return the numbers of each band (`_band`), without the bands in which the joint hardly moved."""
    edges = _edges(spectra.frequency, band)
    parts = (spectra.moved, c.NEGLIGIBLE), (spectra.instrument, c.ROUNDED), (spectra.torque, c.ROUNDED)
    inside, rows = slice(int(edges[0]), int(edges[-1])), list[tuple[float, ...]]()
    for lines in map(slice, edges[:-1].tolist(), edges[1:].tolist()):
        if all(_power(part, lines) > share * _power(part, inside) for part, share in parts):
            rows += _band(spectra, lines)
    return rows


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
