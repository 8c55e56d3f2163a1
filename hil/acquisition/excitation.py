"""Excitations: set-points at the joint as a function of time.

A profile is a pure function of time, so a run of any length is computed block by block. Amplitudes are at the joint: N
m in the coupling for torque, rad of deflection for position. To add a kind of excitation, write one sampler and add one
entry to EXCITATIONS.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Quantity
from hil.errors import WrongUse, unknown
from hil.recording.input import read_text

Array = NDArray[np.float64]
Shape = Callable[[Array], Array]
"""A function that returns set-points of amplitude one at times (n,), s."""
Sampler = Callable[[tuple[float, float], float, int], Shape]
"""A function that makes a shape from the band (Hz), the duration (s) and the seed of random numbers."""

_EDGE = 0.02  # s; a torque step through a cable is eased over this long, so that the cable does not whip
_SHORTEST_FADE = 0.1  # s
_LINES_BLOCK = 256  # of a multisine, worked out at a time
_LINES_PERIOD = 20.0  # s; the longest base period of a multisine, so that its lines stay few
_PRBS_BITS = 15  # of the register
_LARGEST = 1 << 28  # bytes of a file of set-points
_BAND = (0.1, 15.0)  # Hz, unless another is given


@dataclass(frozen=True, slots=True)
class Excitation:
    """One kind of excitation.

    explanation: the text in --list-profiles. band: default band, Hz. sampler: makes the shape; None for the kind that
    follows the CSV of --setpoints. smooth: whether the shape has derivatives, so that the band determines how finely
    the shape must be sampled. speeds: at how many speeds the excitation drives the joint: "one", "band" (the wider the
    band, the more) or "many". one_frequency: whether both ends of the band must be equal. from_zero: whether the
    spectrum begins at zero for every band. searched: whether `hil design` may propose this kind; the search varies the
    upper end of the band and, unless from_zero, the lower end.
    """

    explanation: str
    band: tuple[float, float]
    sampler: Sampler | None
    smooth: bool = False
    speeds: Literal["one", "band", "many"] = "many"
    one_frequency: bool = False
    from_zero: bool = False
    searched: bool = False


@dataclass(frozen=True, slots=True)
class Profile:
    """The set-points of a run as a function of time.

    kind: a key of EXCITATIONS. mode: torque or position. amplitude: largest magnitude, N m or rad at the joint.
    duration: s. band: Hz. fade: duration of the raised-cosine start and of the stop, s. seed: for the random part (the
    phase of a PRBS). setpoints: path of the CSV with the set-points, "" for a profile without a CSV. shape: the
    set-points for amplitude one, without fades.
    """

    kind: str
    mode: Quantity
    amplitude: float
    duration: float
    band: tuple[float, float]
    fade: float
    seed: int
    setpoints: str
    shape: Shape

    @property
    def excitation(self) -> Excitation:
        """Return the entry of EXCITATIONS for the kind of this profile."""
        return EXCITATIONS[self.kind]

    def at(self, time: Array) -> Array:
        """Return the set-points at `time` (n,) s since the start, (n,) N m or rad; zero outside the duration."""
        inside = (time >= 0.0) & (time <= self.duration)
        clipped = np.clip(time, 0.0, self.duration)
        edge = np.minimum(clipped, self.duration - clipped) / self.fade
        envelope = 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1.0))
        return np.where(inside, self.amplitude * envelope * self.shape(clipped), 0.0)

    def attributes(self) -> dict[str, str | float]:
        """Return the attributes of the recording's /profile group, from which the profile can be computed again."""
        return {
            "kind": self.kind,
            "mode": self.mode.value,
            "amplitude": self.amplitude,
            "duration": self.duration,
            "band_low": self.band[0],
            "band_high": self.band[1],
            "fade": self.fade,
            "seed": self.seed,
            "setpoints": self.setpoints,
        }


def make(
    kind: str,
    mode: Quantity,
    *,
    amplitude: float | None,
    default_amplitude: float,
    duration: float | None,
    band: tuple[float, float] | None,
    rate: float,
    fade: float = 1.0,
    seed: int = 0,
    setpoints: Path | None = None,
) -> Profile:
    """Return a checked profile.

    amplitude: N m or rad at the joint; None: `default_amplitude`, or the peak of the set-point file. duration: s; None:
    20 s, or as long as the set-point file. band: Hz. rate: sampling rate, Hz, for the Nyquist check. fade: s. seed: for
    the random part. setpoints: path of a CSV with set-points. Raises WrongUse.
    """
    if kind not in EXCITATIONS:
        raise unknown("profile", kind, EXCITATIONS, " (see: hil record --list-profiles)")
    excitation = EXCITATIONS[kind]
    if (excitation.sampler is None) != (setpoints is not None):
        raise WrongUse("--profile file and --setpoints FILE.csv go together: give both or neither")
    if setpoints is not None and band is not None:
        raise WrongUse("--band has no meaning with --profile file: the set-points are the file's; leave it out")
    shape: Shape | None = None
    peak, end = default_amplitude, 20.0
    if setpoints is not None:
        shape, peak, end = _from_file(setpoints)
    amplitude = peak if amplitude is None else amplitude
    duration = end if duration is None else duration
    _check_positive(amplitude, duration, fade)
    band = excitation.band if band is None else band
    if excitation.sampler is not None:
        _check_band(excitation, band, rate)
        shape = excitation.sampler(band, duration, seed)
    assert shape is not None  # noqa: S101 - one of the two has made it
    fade = min(fade, duration / 4.0)
    return Profile(kind, mode, amplitude, duration, band, fade, seed, str(setpoints or ""), shape)


def _check_positive(amplitude: float, duration: float, fade: float) -> None:
    for name, value in (("amplitude", amplitude), ("duration", duration)):
        if not (math.isfinite(value) and value > 0.0):
            raise WrongUse(f"--{name} {value:g}: it must be a number above zero")
    if not (math.isfinite(fade) and fade >= _SHORTEST_FADE):
        raise WrongUse(f"--fade {fade:g}: it must be at least {_SHORTEST_FADE:g} s, so that the torque does not jump")


def _check_band(excitation: Excitation, band: tuple[float, float], rate: float) -> None:
    low, high = band
    if not (math.isfinite(low) and math.isfinite(high) and low > 0.0):
        raise WrongUse(f"--band {low:g}:{high:g}: both ends must be numbers above zero, in Hz")
    if high < low:
        raise WrongUse(f"--band {low:g}:{high:g} is reversed: write --band {high:g}:{low:g}")
    if excitation.one_frequency and high != low:
        raise WrongUse(f"this excitation has one frequency: write --band {low:g}, or use --profile chirp for a range")
    if high > rate / 4.0:
        raise WrongUse(
            f"--band up to {high:g} Hz needs a rate of at least {4.0 * high:g} Hz: "
            f"raise --rate (now {rate:g}) or lower the band"
        )


def _chirp(band: tuple[float, float], duration: float, seed: int) -> Shape:
    del seed
    low, high = band
    if high == low:
        return _sine(band, duration, 0)
    growth = math.log(high / low) / duration
    return lambda time: np.sin(2.0 * np.pi * low / growth * np.expm1(growth * time))


def _sine(band: tuple[float, float], duration: float, seed: int) -> Shape:
    del duration, seed
    return lambda time: np.sin(2.0 * np.pi * band[0] * time)


def _multisine(band: tuple[float, float], duration: float, seed: int) -> Shape:
    """Return a multisine: sines of equal amplitude with phases after Schroeder (1970), scaled to a peak of one."""
    del seed
    period = min(duration, _LINES_PERIOD)
    lines = np.arange(max(1, math.ceil(band[0] * period)), math.floor(band[1] * period) + 1)
    if lines.size == 0:
        raise WrongUse(f"no frequency of a {period:g} s multisine lies in {band[0]:g}:{band[1]:g} Hz: widen --band")
    order = np.arange(1, lines.size + 1)
    phases = -np.pi * order * (order - 1) / lines.size
    omega = 2.0 * np.pi * lines / period

    def total(time: Array) -> Array:
        values = np.zeros_like(time)
        for first in range(0, lines.size, _LINES_BLOCK):  # a wide band has 50,000 lines, too many for one table
            some = slice(first, first + _LINES_BLOCK)
            values += np.cos(np.outer(time, omega[some]) + phases[some]).sum(axis=1)
        return values

    # sixteen points a period of the fastest line find the peak to within 2 %, which the scale leaves room for
    points = 16 * int(lines[-1])
    spectrum = np.zeros(points // 2 + 1, dtype=np.complex128)
    spectrum[lines] = 0.5 * points * np.exp(1j * phases)
    peak = 1.02 * float(np.abs(np.fft.irfft(spectrum, points)).max())
    return lambda time: total(time) / peak


def _steps(band: tuple[float, float], duration: float, seed: int) -> Shape:
    del duration, seed
    levels = np.array([0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5])
    dwell = 1.0 / (band[0] * levels.size)
    edge = min(_EDGE, dwell / 2.0)

    def staircase(time: Array) -> Array:
        index = np.floor(time / dwell).astype(np.int64)
        blend = 0.5 - 0.5 * np.cos(np.pi * np.clip((time - index * dwell) / edge, 0.0, 1.0))
        return np.asarray((1.0 - blend) * levels[(index - 1) % 8] + blend * levels[index % 8])

    return staircase


def _ramp(band: tuple[float, float], duration: float, seed: int) -> Shape:
    del duration, seed
    return lambda time: 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * band[0] * time))


def _prbs(band: tuple[float, float], duration: float, seed: int) -> Shape:
    """Return a PRBS: the maximum-length sequence of x^15 + x^14 + 1. One bit lasts 1/(2.5 f_high), so that the spectrum
    is flat within 1 dB up to f_high.
    """
    from scipy.signal import max_len_seq

    del duration
    clock = 2.5 * band[1]
    length = 2**_PRBS_BITS - 1
    register = 1 + seed % length
    state = [register >> place & 1 for place in reversed(range(_PRBS_BITS))]
    bits = 2.0 * np.roll(max_len_seq(_PRBS_BITS, state=state, taps=[1])[0], -_PRBS_BITS) - 1.0
    edge = min(_EDGE, 0.5 / clock)

    def sequence(time: Array) -> Array:
        index = np.floor(time * clock).astype(np.int64)
        blend = 0.5 - 0.5 * np.cos(np.pi * np.clip((time - index / clock) / edge, 0.0, 1.0))
        return np.asarray((1.0 - blend) * bits[(index - 1) % length] + blend * bits[index % length])

    return sequence


def _from_file(path: Path) -> tuple[Shape, float, float]:
    """Return the shape in a CSV of two columns, the largest magnitude of its set-points (N m or rad) and its last time
    (s).
    """
    text = read_text(path, largest=_LARGEST)
    try:
        rows = [row for row in csv.reader(text.splitlines()) if row and not row[0].startswith("#")]
    except csv.Error as error:
        raise WrongUse(f"{path}: the set-points are not a CSV table ({error})") from None
    body = rows[1:] if rows and not _is_number(rows[0][0]) else rows
    for number, row in enumerate(body, start=1 + len(rows) - len(body)):
        if len(row) != 2 or not all(_is_number(cell) for cell in row):
            raise WrongUse(f"{path}, row {number}: expected two numbers, time (s) and set-point, got {','.join(row)!r}")
    table = np.array(body, dtype=np.float64).reshape(-1, 2)
    time, value = table[:, 0], table[:, 1]
    if time.size < 2 or np.any(np.diff(time) <= 0.0) or time[0] < 0.0:
        raise WrongUse(f"{path}: set-points need at least two rows and a time that starts at zero or later and rises")
    peak = float(np.abs(value).max())
    if peak == 0.0:
        raise WrongUse(f"{path}: all set-points are zero")
    return lambda at: np.interp(at, time, value / peak), peak, float(time[-1])


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


EXCITATIONS: Mapping[str, Excitation] = MappingProxyType(
    {
        "chirp": Excitation(
            "a rising sine, the same time in every octave", _BAND, _chirp, smooth=True, speeds="band", searched=True
        ),
        "multisine": Excitation(
            "all frequencies of the band at once", _BAND, _multisine, smooth=True, speeds="band", searched=True
        ),
        "sine": Excitation("one frequency: --band 2", (1.0, 1.0), _sine, smooth=True, speeds="one", one_frequency=True),
        "steps": Excitation("a staircase up and down, repeated at the band's lower end", (0.25, 0.25), _steps),
        "ramp": Excitation("a slow triangle at the band's lower end", (0.05, 0.05), _ramp, speeds="one"),
        "prbs": Excitation(
            "a pseudo-random binary sequence up to the band's upper end",
            _BAND,
            _prbs,
            from_zero=True,
            searched=True,
        ),
        "file": Excitation("a CSV of time (s) and set-point, interpolated: --setpoints FILE", (0.0, 0.0), None),
    }
)
"""All kinds of excitation, by the name that --profile takes."""
