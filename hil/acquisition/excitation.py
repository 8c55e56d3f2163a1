"""What the motor is asked to do: set-points at the joint as a function of time.

A profile is a pure function of time, so a run of any length is made block by block. Amplitudes are at the joint:
N m in the coupling for torque, rad of deflection for position.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Quantity
from hil.errors import WrongUse

Array = NDArray[np.float64]
Shape = Callable[[Array], Array]

_EDGE = 0.02  # s; a torque step through a cable is eased over this long, so that the cable does not whip
_SHORTEST_FADE = 0.1  # s
_LINES_BLOCK = 256  # of a multisine, worked out at a time
_LINES_PERIOD = 20.0  # s; the longest base period of a multisine, so that its lines stay few


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of profile: the sentence that explains it, and the band (Hz) it has when none is given."""

    explanation: str
    band: tuple[float, float]


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "chirp": Kind("a sine whose frequency rises through the band, the same time in every octave", (0.1, 15.0)),
        "multisine": Kind("all the band's frequencies at once, phased for a low peak (Schroeder)", (0.1, 15.0)),
        "sine": Kind("one frequency: --band 2", (1.0, 1.0)),
        "steps": Kind("a staircase 0, 1/2, 1, 1/2, 0 and its mirror, repeated at the band's lower end", (0.25, 0.25)),
        "ramp": Kind("a slow triangle at the band's lower end: the static curve and its friction loop", (0.05, 0.05)),
        "prbs": Kind("a pseudo-random binary sequence, flat up to the band's upper end", (0.1, 15.0)),
        "file": Kind("a CSV of time (s) and set-point, joined by straight lines: --setpoints FILE", (0.0, 0.0)),
    }
)


@dataclass(frozen=True, slots=True)
class Profile:
    """Set-points over time.

    amplitude: largest magnitude, N m or rad at the joint. duration: s. band: Hz. fade: s of raised-cosine start and
    stop. seed: what is random in it (the phase of a PRBS). setpoints: the CSV behind kind "file".
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

    def at(self, time: Array) -> Array:
        """The set-points at `time` (n,) s since the start, (n,) N m or rad; zero before the start and after the end."""
        inside = (time >= 0.0) & (time <= self.duration)
        held = np.clip(time, 0.0, self.duration)
        edge = np.minimum(held, self.duration - held) / self.fade
        envelope = 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1.0))
        return np.where(inside, self.amplitude * envelope * self.shape(held), 0.0)

    def attributes(self) -> dict[str, str | float]:
        """Everything that makes this profile again, for the recording's /profile group."""
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
    """A checked profile.

    amplitude N m or rad at the joint (None: `default_amplitude`, and the file's own peak for kind "file"); duration s
    (None: 20 s, or as long as the file); band Hz; rate Hz, for the Nyquist check; fade s.
    Raises WrongUse, saying what is wrong and what would do.
    """
    if kind not in KINDS:
        raise WrongUse(f"unknown profile {kind!r}: known are {', '.join(KINDS)} (see: hil record --list-profiles)")
    if (kind == "file") != (setpoints is not None):
        raise WrongUse("--profile file and --setpoints FILE.csv go together: give both or neither")
    if setpoints is not None:
        if band is not None:
            raise WrongUse("--band has no meaning with --profile file: the set-points are the file's; leave it out")
        shape, peak, end = _from_file(setpoints)
        amplitude = peak if amplitude is None else amplitude
        duration = end if duration is None else duration
        chosen = KINDS[kind].band
    else:
        amplitude = default_amplitude if amplitude is None else amplitude
        duration = 20.0 if duration is None else duration
        chosen = _checked_band(kind, KINDS[kind].band if band is None else band, rate)
        _check_positive(amplitude, duration, fade)
        shape = _SHAPES[kind](chosen, duration, seed)
    _check_positive(amplitude, duration, fade)
    fade = min(fade, duration / 4.0)
    return Profile(kind, mode, amplitude, duration, chosen, fade, seed, str(setpoints or ""), shape)


def _check_positive(amplitude: float, duration: float, fade: float) -> None:
    for name, value, least in (("amplitude", amplitude, 0.0), ("duration", duration, 0.0)):
        if not (math.isfinite(value) and value > least):
            raise WrongUse(f"--{name} {value:g}: it must be a number above zero")
    if not (math.isfinite(fade) and fade >= _SHORTEST_FADE):
        raise WrongUse(f"--fade {fade:g}: it must be at least {_SHORTEST_FADE:g} s, so that no torque is switched")


def _checked_band(kind: str, band: tuple[float, float], rate: float) -> tuple[float, float]:
    low, high = band
    if not (math.isfinite(low) and math.isfinite(high) and low > 0.0):
        raise WrongUse(f"--band {low:g}:{high:g}: both ends must be numbers above zero, in Hz")
    if high < low:
        raise WrongUse(f"--band {low:g}:{high:g} is reversed: write --band {high:g}:{low:g}")
    if kind == "sine" and high != low:
        raise WrongUse(f"a sine has one frequency: write --band {low:g}, or use --profile chirp for a range")
    if high > rate / 4.0:
        raise WrongUse(
            f"--band up to {high:g} Hz needs a rate of at least {4.0 * high:g} Hz: "
            f"raise --rate (now {rate:g}) or lower the band"
        )
    return low, high


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
    """Equal amplitudes, phases after Schroeder (1970), scaled to a peak of one."""
    del seed
    period = min(duration, _LINES_PERIOD)
    lines = np.arange(max(1, math.ceil(band[0] * period)), math.floor(band[1] * period) + 1)
    if lines.size == 0:
        raise WrongUse(f"no line of a {period:g} s multisine lies in {band[0]:g}:{band[1]:g} Hz: widen --band")
    order = np.arange(1, lines.size + 1)
    phases = -np.pi * order * (order - 1) / lines.size
    omega = 2.0 * np.pi * lines / period

    def total(time: Array) -> Array:
        found = np.zeros_like(time)
        for first in range(0, lines.size, _LINES_BLOCK):  # a wide band has 50,000 lines, too many for one table
            some = slice(first, first + _LINES_BLOCK)
            found += np.cos(np.outer(time, omega[some]) + phases[some]).sum(axis=1)
        return found

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
    """A maximum-length sequence from x^15 + x^14 + 1, one bit each 1/(2.5 f_high), flat within 1 dB to f_high."""
    clock = 2.5 * band[1]
    register = 1 + seed % 32767
    bits = np.empty(32767)
    for index in range(bits.size):
        bit = ((register >> 14) ^ (register >> 13)) & 1
        register = ((register << 1) | bit) & 0x7FFF
        bits[index] = 2.0 * bit - 1.0
    edge = min(_EDGE, 0.5 / clock)
    del duration

    def sequence(time: Array) -> Array:
        index = np.floor(time * clock).astype(np.int64)
        blend = 0.5 - 0.5 * np.cos(np.pi * np.clip((time - index / clock) / edge, 0.0, 1.0))
        return np.asarray((1.0 - blend) * bits[(index - 1) % 32767] + blend * bits[index % 32767])

    return sequence


_SHAPES: Mapping[str, Callable[[tuple[float, float], float, int], Shape]] = MappingProxyType(
    {"chirp": _chirp, "sine": _sine, "multisine": _multisine, "steps": _steps, "ramp": _ramp, "prbs": _prbs}
)


def _from_file(path: Path) -> tuple[Shape, float, float]:
    """The shape in a CSV of two columns, its peak (N m or rad) and its end (s)."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise WrongUse(f"{path}: the set-points cannot be read ({error})") from None
    try:
        rows = [row for row in csv.reader(text.splitlines()) if row and not row[0].startswith("#")]
    except csv.Error as error:
        raise WrongUse(f"{path}: the set-points are no CSV ({error})") from None
    body = rows[1:] if rows and not _is_number(rows[0][0]) else rows
    for number, row in enumerate(body, start=1 + len(rows) - len(body)):
        if len(row) != 2 or not all(_is_number(cell) for cell in row):
            raise WrongUse(
                f"{path}, row {number}: expected two numbers, time (s) and set-point, found {','.join(row)!r}"
            )
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
