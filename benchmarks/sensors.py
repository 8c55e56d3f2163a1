"""What slow, joined and filtered torque readings do to Kc and Bc: `python benchmarks/sensors.py [--seeds 3] [--write]`.

The deflection is prescribed as a function of time, and the torque follows from it on a grid a hundred times as fine as
the ticks; a cell converts it at times of its own, and a logger polls it. A result is right (Kc within 0.5 %, Bc within
3 %, or within 1.5 times the interval), flagged (an error about what is wrong, or for Bc a warning about the sensors),
or confidently wrong.
"""

from __future__ import annotations

import argparse
import tempfile
import time as clock
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from page import machine, write_result
from scipy import signal

from hil.errors import Untrustworthy
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.recording.writer import Header, write

Array = NDArray[np.float64]

FINE = 100  # grid points a tick
TICKS, SECONDS = 500.0, 20.0
KC, BC, NOISE = 0.3, 3e-3, 1e-3
COUNT = 2.0 * np.pi / 2**18  # rad
KC_WITHIN, BC_WITHIN, OUTSIDE = 5e-3, 0.03, 1.5


@dataclass(frozen=True, slots=True)
class Bench:
    """size: of all torques; rate: ticks a second, by which all times scale. noise: N m before that. seed: of all."""

    motion: str = "multisine"
    size: float = 1.0
    rate: float = TICKS
    noise: float = NOISE
    inertia: float = 0.0
    seed: int = 0

    @property
    def step(self) -> float:
        """Between two points of the grid, of a bench with 500 ticks a second."""
        return 1.0 / (TICKS * FINE)


Reading = Callable[[Array, Array, np.random.Generator, float], Array]
"""What is logged at each tick: of a torque (m,) on times (m,) s, with noise of a standard deviation."""


def moved(bench: Bench, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Times (m,) s, deflection rad, rate and acceleration on the grid."""
    time = np.arange(int(SECONDS * TICKS) * FINE) * bench.step
    if bench.motion == "chirp":
        slope = (12.0 - 0.3) / SECONDS
        phase, omega = 2.0 * np.pi * (0.3 * time + 0.5 * slope * time**2), 2.0 * np.pi * (0.3 + slope * time)
        wave, turned = np.sin(phase), np.cos(phase)
        return time, 0.25 * wave, 0.25 * omega * turned, 0.25 * (2.0 * np.pi * slope * turned - omega**2 * wave)
    count, top = (12, 12.0) if bench.motion == "multisine" else (200, 20.0)
    frequency = np.arange(1, count + 1) * round(top / count * SECONDS) / SECONDS
    size = np.ones(count) if bench.motion == "multisine" else 1.0 / (1.0 + (frequency / 3.0) ** 2)
    spectrum = np.zeros(len(time) // 2 + 1, dtype=np.complex128)
    at = np.round(frequency * len(time) * bench.step).astype(int)
    spectrum[at] = size * np.exp(2j * np.pi * rng.uniform(size=count))
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(time), bench.step)
    angle, rate, acceleration = (np.fft.irfft(spectrum * (1j * omega) ** order, len(time)) for order in range(3))
    scale = 0.25 / np.abs(angle).max()
    return time, scale * angle, scale * rate, scale * acceleration


def polled(time: Array) -> Array:
    """The times of the ticks."""
    return time[::FINE]


def plain(_time: Array, torque: Array, rng: np.random.Generator, noise: float) -> Array:
    """A cell that converts at each tick."""
    return torque[::FINE] + noise * rng.standard_normal(len(torque[::FINE]))


def conversions(time: Array, hertz: float, rng: np.random.Generator, jitter: float) -> Array:
    """The times at which a cell of its own clock converts."""
    period = 1.0 / (hertz * (1.0 + 1e-4 * rng.standard_normal()))
    count = int(time[-1] / period) + 3
    return np.cumsum(period * (1.0 + jitter * rng.uniform(-1.0, 1.0, count))) - period * (1.0 + rng.uniform())


def converted(at: Array, time: Array, torque: Array, rng: np.random.Generator, noise: float) -> Array:
    """A cell's readings (m,) at its conversions at (m,) s."""
    return np.asarray(np.interp(at, time, torque) + noise * rng.standard_normal(len(at)))


def held(hertz: float, *, jitter: float = 0.0, lsb: float = 0.0, decimals: int = 12) -> Reading:
    """A cell of so many Hz whose reading is repeated until the next."""

    def read(time: Array, torque: Array, rng: np.random.Generator, noise: float) -> Array:
        at = conversions(time, hertz, rng, jitter)
        readings = converted(at, time, torque, rng, noise)
        if lsb:
            readings = lsb * noise * np.round(readings / (lsb * noise))
        return np.round(readings[np.maximum(np.searchsorted(at, polled(time), side="right") - 1, 0)], decimals)

    return read


def joined(hertz: float, *, kind: str = "linear", decimals: int = 9) -> Reading:
    """A cell of so many Hz whose readings were resampled at the ticks."""

    def read(time: Array, torque: Array, rng: np.random.Generator, noise: float) -> Array:
        from scipy.interpolate import CubicSpline, PchipInterpolator

        at = conversions(time, hertz, rng, 0.0)
        readings = converted(at, time, torque, rng, noise)
        curves = {"cubic": CubicSpline, "pchip": PchipInterpolator}
        found = np.interp(polled(time), at, readings) if kind == "linear" else curves[kind](at, readings)(polled(time))
        return np.round(found, decimals)

    return read


def behind(numerator: Array, denominator: Array, *, each: int = 1) -> Reading:
    """A filter of the grid's points, or of every `each`-th, that the noisy torque passes."""

    def read(_time: Array, torque: Array, rng: np.random.Generator, noise: float) -> Array:
        taken = torque[::each]
        noisy = taken + noise * np.sqrt(FINE / each) * rng.standard_normal(len(taken))
        start = signal.lfilter_zi(numerator, denominator) * taken[0]
        return np.asarray(signal.lfilter(numerator, denominator, noisy, zi=start)[0][:: FINE // each])

    return read


def averaged(ticks: int) -> Reading:
    """The mean of the latest readings."""
    return behind(np.full(ticks, 1.0 / ticks), np.ones(1), each=FINE)


def butterworth(order: int, hertz: float) -> Reading:
    """A low-pass of the cell."""
    return behind(*signal.butter(order, hertz / (0.5 * TICKS * FINE)))


def bessel(order: int, hertz: float) -> Reading:
    """A low-pass of the cell with an even delay."""
    return behind(*signal.bessel(order, hertz / (0.5 * TICKS * FINE), norm="mag"))


def median(ticks: int) -> Reading:
    """The median of the latest readings."""

    def read(time: Array, torque: Array, rng: np.random.Generator, noise: float) -> Array:
        noisy = np.concatenate([np.full(ticks - 1, torque[0]), plain(time, torque, rng, noise)])
        return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(noisy, ticks), axis=1))

    return read


def delayed(ms: float) -> Reading:
    """A reading that comes late."""

    def read(time: Array, torque: Array, rng: np.random.Generator, noise: float) -> Array:
        late = np.interp(polled(time) - 1e-3 * ms, time, torque)
        return late + noise * rng.standard_normal(len(late))

    return read


CASES: dict[str, tuple[Bench, Reading]] = {
    "clean": (Bench(), plain),
    "clean, coarse cell of 5 mN m": (Bench(), lambda t, x, g, n: 5e-3 * np.round(plain(t, x, g, 0.2 * n) / 5e-3)),
    **{f"held, {hz} Hz": (Bench(), held(hz)) for hz in (30, 50, 80, 100, 200)},
    "held, 80 Hz, uneven": (Bench(), held(80, jitter=0.4)),
    "held, 80 Hz, coarse": (Bench(), held(80, lsb=1.0)),
    "held, 80 Hz, chirp": (Bench("chirp"), held(80)),
    "held, 80 Hz, random": (Bench("random"), held(80)),
    "held, 40 Hz, random": (Bench("random"), held(40)),
    "held, 80 Hz, 0.01 N m/rad": (Bench(size=1 / 30), held(80)),
    "held, 16 % of 100 Hz, 500 N m/rad": (Bench(size=1666, rate=100.0), held(80)),
    "held, 16 % of 1000 Hz": (Bench(rate=1000.0), held(80)),
    **{f"joined, {hz} Hz": (Bench(), joined(hz)) for hz in (30, 50, 80, 100, 200)},
    "joined, 80 Hz, 5 decimals": (Bench(), joined(80, decimals=5)),
    "joined, 80 Hz, chirp": (Bench("chirp"), joined(80)),
    "joined, 80 Hz, random": (Bench("random"), joined(80)),
    "cubic, 80 Hz": (Bench(), joined(80, kind="cubic")),
    "cubic, 30 Hz": (Bench(), joined(30, kind="cubic")),
    "pchip, 50 Hz": (Bench(), joined(50, kind="pchip")),
    **{f"mean of {n}": (Bench(), averaged(n)) for n in (3, 5, 10, 20)},
    "mean of 10, chirp": (Bench("chirp"), averaged(10)),
    "mean of 10, random": (Bench("random"), averaged(10)),
    "mean of 10, 1000 Hz": (Bench(rate=1000.0), averaged(10)),
    "median of 5": (Bench(), median(5)),
    "median of 11": (Bench(), median(11)),
    "lag, 30 Hz": (Bench(), butterworth(1, 30.0)),
    "Butterworth 2, 30 Hz": (Bench(), butterworth(2, 30.0)),
    "Butterworth 2, 60 Hz, random": (Bench("random"), butterworth(2, 60.0)),
    "Butterworth 4, 40 Hz": (Bench(), butterworth(4, 40.0)),
    "Bessel 4, 40 Hz": (Bench(), bessel(4, 40.0)),
    "9 ms late": (Bench(), delayed(9.0)),
    "30 ms late": (Bench(), delayed(30.0)),
    "3 ms early": (Bench(), delayed(-3.0)),
    **{f"inertia, {size:g} of Kc at 5 Hz": (Bench(inertia=size), plain) for size in (0.05, 0.3, 1.0)},
    "inertia, 0.3, chirp": (Bench("chirp", inertia=0.3), plain),
    "inertia, 0.3, random": (Bench("random", inertia=0.3), plain),
}


def made(bench: Bench, reading: Reading, path: Path) -> tuple[float, float]:
    """Write the recording; return its Kc and Bc."""
    rng = np.random.default_rng([bench.seed, 11])
    time, angle, rate, acceleration = moved(bench, rng)
    faster = bench.rate / TICKS
    torque = KC * angle + BC * rate + bench.inertia * KC / (2.0 * np.pi * 5.0) ** 2 * acceleration
    measured = reading(time, torque + 0.01, rng, bench.noise)
    channels = {
        "time": polled(time) / faster,
        "torque": bench.size * measured,
        "dtheta": COUNT * np.round(angle[::FINE] / COUNT),
    }
    write(path, Header(profile={"kind": "closed form"}), channels, force=True)
    return KC * bench.size, BC * bench.size / faster


@dataclass(frozen=True, slots=True)
class Outcome:
    """One recording: relative errors, the verdict, the model, the codes of the diagnostics, and s it took."""

    Kc: float
    Bc: float
    verdict: str
    model: str
    codes: tuple[str, ...]
    seconds: float


_BESIDE = {"slow-sensor", "torque-reading", "inertia-in-torque", "misfit", "late-torque"}


def outcome(bench: Bench, reading: Reading, folder: Path) -> Outcome:
    """Make and identify one recording."""
    path = folder / "one.h5"
    true, began = made(bench, reading, path), clock.perf_counter()
    try:
        found = identify([path], None, Search(seed=bench.seed))
    except Untrustworthy as error:
        return Outcome(np.nan, np.nan, "flagged", str(error)[:60], (), clock.perf_counter() - began)
    apart, wrong = [], []
    for one, value, within in zip(found.estimates[:2], true, (KC_WITHIN, BC_WITHIN), strict=True):
        half = 0.5 * (one.ci95[1] - one.ci95[0])
        apart.append(one.value / value - 1.0)
        wrong.append(abs(apart[-1]) > within and abs(one.value - value) > OUTSIDE * half)
    errors = [one.parameter for one in found.diagnostics if one.is_error]
    warned = {one.code for one in found.diagnostics} & _BESIDE
    flagged = [None in errors or name in errors or (name == "Bc" and warned) for name in ("Kc", "Bc")]
    verdict = "right"
    if any(wrong):
        verdict = "flagged" if all(f for w, f in zip(wrong, flagged, strict=True) if w) else "WRONG"
    elif errors:
        verdict = "right, flagged"
    codes = tuple(("!" if one.is_error else "") + one.code for one in found.diagnostics)
    return Outcome(apart[0], apart[1], verdict, found.model.name, codes, clock.perf_counter() - began)


def outcomes(names: list[str], seeds: int) -> Iterator[tuple[str, list[Outcome]]]:
    """Identify each case with some seeds."""
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            bench, reading = CASES[name]
            yield name, [outcome(replace(bench, seed=seed), reading, Path(folder)) for seed in range(seeds)]


def line(name: str, found: list[Outcome]) -> str:
    """A row of the table."""
    worst = [np.nanmax([abs(getattr(one, which)) for one in found] + [0.0]) for which in ("Kc", "Bc")]
    verdicts = sorted({one.verdict for one in found})
    counted = ", ".join(f"{sum(one.verdict == verdict for one in found)} {verdict}" for verdict in verdicts)
    return f"| {name} | {worst[0]:.2%} | {worst[1]:.2%} | {counted} | {found[0].model} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--write", action="store_true", help="write results/sensors.csv")
    options = parser.parse_args()
    names = [name for name in CASES if any(part in name for part in options.only.split("|"))]
    head = ["| recording | Kc, worst | Bc, worst | verdicts | model of the first |", "| --- | --- | --- | --- | --- |"]
    rows = list(head)
    for name, found in outcomes(names, options.seeds):
        rows.append(line(name, found))
        print(rows[-1], flush=True)
        for one in found if options.verbose else ():
            print(
                f"    {one.Kc:+.2%} {one.Bc:+.2%} {one.verdict} {one.model} {one.codes} {one.seconds:.1f} s", flush=True
            )
    if options.write:
        write_result("sensors", "\n".join([f"{machine()}.", *rows]))


if __name__ == "__main__":
    main()
