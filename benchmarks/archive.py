"""Recordings with known Kc and Bc, to compare two revisions: `python benchmarks/archive.py FOLDER [--ramps FOLDER]`.

Writes FOLDER/index.csv and the recordings (HDF5) that it names; a file that exists is kept, so a run that was stopped
goes on. `benchmarks/replay.py` identifies them. Everything follows from seeds; only real ramps (`real_ramps.py`), whose
Kc nobody knows, need a folder of their own. Columns of the index: file; kind; half, "seen" or "held" (alternating in
each kind: held ones are looked at only at the end); arguments of `hil identify`; Kc and Bc, SI, empty if unknown;
knowable: which of them the recording identifies, so that a refusal of it is needless.
"""

from __future__ import annotations

import argparse
import csv
import functools
import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import benches
import default_stand
import numpy as np
import real_ramps
import textbook
import truth_benches
from archive_physical import PAIRS, draw, read
from benches import KC, MUJOCO, Array, Bench, Law, Motion, Reading
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfilt, sosfilt_zi
from truth_cases import CASES
from truth_page import UNIDENTIFIABLE
from truth_recordings import SOURCES, can_make

from hil.recording.writer import Header, write

INDEX = "index.csv"
MOST = 9990  # rows of a recording
BOTH, ONLY_KC, NEITHER = "Kc Bc", "Kc", ""


class Entry(NamedTuple):
    """One recording of the archive; make: writes it to a path. Kc, Bc: SI, NaN where nobody knows them."""

    kind: str
    make: Callable[[Path], object]
    Kc: float
    Bc: float
    knowable: str = BOTH
    arguments: str = ""


Change = Callable[[Reading, np.random.Generator], Reading]
"""What sensors do to a reading beside what a bench says."""


def filtered(torque: float = 0.0, deflection: float = 0.0, order: int = 2) -> Change:
    """A Butterworth filter at so many Hz in the torque, the deflection or both, 0: none."""

    def change(reading: Reading, _: np.random.Generator) -> Reading:
        rate = 1.0 / float(np.median(np.diff(reading.time)))

        def low(values: Array, corner: float) -> Array:
            if not corner:
                return values
            sections = butter(order, corner, fs=rate, output="sos")
            return np.asarray(sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])[0])

        return replace(reading, torque=low(reading.torque, torque), deflection=low(reading.deflection, deflection))

    return change


def resampled(reading: Reading, _: np.random.Generator) -> Reading:
    """The torque as a smooth curve through each sixth reading."""
    return replace(reading, torque=CubicSpline(reading.time[::6], reading.torque[::6])(reading.time))


def wandering(share: float, seconds: float = 5.0) -> Change:
    """A zero of the torque that wanders by `share` of its peak within so many seconds."""

    def change(reading: Reading, rng: np.random.Generator) -> Reading:
        walk = _coloured(len(reading.time), seconds / float(reading.time[1]), rng)
        return replace(reading, torque=reading.torque + share * np.abs(reading.torque).max() * walk)

    return change


def tared(share: float) -> Change:
    """The cell set to zero half way, under a load of `share` of the torque's peak."""

    def change(reading: Reading, _: np.random.Generator) -> Reading:
        late = reading.time > 0.5 * reading.time[-1]
        return replace(reading, torque=reading.torque - share * np.abs(reading.torque).max() * late)

    return change


def trembling(noise: float) -> Change:
    """Noise of the angle, rad, correlated over 20 samples."""
    return lambda reading, rng: replace(
        reading, deflection=reading.deflection + noise * _coloured(len(reading.time), 20.0, rng)
    )


def _coloured(count: int, samples: float, rng: np.random.Generator) -> Array:
    """Noise of standard deviation 1 that is correlated over so many samples."""
    keep = np.exp(-1.0 / samples)
    return np.asarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(count)))


def _beside(more: Callable[[Motion], Array]) -> Law:
    """Spring and damper, and `more` torque."""
    return lambda m, k, b: np.asarray(k * m.deflection + b * m.rate + more(m))


def _branches(*of: tuple[float, float]) -> Law:
    """Branches of a share of Kc each that relax in so many seconds."""
    laws = [benches.viscoelastic(share, constant) for share, constant in of]

    def law(m: Motion, k: float, b: float) -> Array:
        plain = k * m.deflection + b * m.rate
        return np.asarray(plain + sum(one(m, k, b) - plain for one in laws))

    return law


def _stribeck(m: Motion) -> Array:
    return np.asarray(2e-3 * (1.0 + np.exp(-((m.rate / 0.3) ** 2))) * np.tanh(m.rate / 1e-3))


def _toe(m: Motion, sides: tuple[float, ...]) -> Array:
    """Exponential springs of 30 % of Kc without their linear part: one tendon, or a pair of them."""
    return np.asarray(sum(0.3 * KC / 8.0 * (np.expm1(8.0 * s * m.deflection) / s - 8.0 * m.deflection) for s in sides))


_ONE, _PRBS = Bench(), Bench(kind="prbs", band=(0.2, 12.0))
_QUIET = Bench(torque_noise=2e-5, bits=20)
_SLOW = Bench(rate=100.0, band=(0.2, 8.0), bits=14)
_RUBBING = benches.friction(2e-3)
KINDS: Mapping[str, tuple[Bench, Change | None, str]] = {
    "cell with Butterworth, 40 Hz": (_ONE, filtered(torque=40.0), ONLY_KC),
    "cell of second order, 60 Hz": (_ONE, filtered(torque=60.0), ONLY_KC),
    "torque resampled": (_ONE, resampled, NEITHER),
    "angle filtered, 60 Hz": (_ONE, filtered(deflection=60.0, order=1), ONLY_KC),
    "torque and angle filtered": (_ONE, filtered(50.0, 50.0), BOTH),
    "wandering zero, 5 s of ramps": (replace(_ONE, kind="ramp", duration=5.0), wandering(0.03), ONLY_KC),
    "wandering zero": (_ONE, wandering(0.03), BOTH),
    "few counts": (replace(_ONE, bits=12, peak=0.006), None, NEITHER),
    "angle noise, not white": (_ONE, trembling(5e-3), NEITHER),
    "Stribeck": (replace(_ONE, law=_beside(_stribeck)), None, BOTH),
    "two branches": (replace(_ONE, law=_branches((0.2, 0.01), (0.2, 0.2))), None, BOTH),
    "three branches": (replace(_ONE, law=_branches((0.2, 0.01), (0.2, 0.07), (0.2, 0.5))), None, NEITHER),
    "creep": (replace(_ONE, law=_branches(*((0.05, 10.0**p) for p in (-2.0, -1.0, 0.0, 1.0)))), None, NEITHER),
    "branch slower than the motion": (replace(_ONE, law=benches.viscoelastic(0.3, 20.0)), None, "Bc"),
    "toe, zero unknown": (replace(_ONE, law=_beside(lambda m: _toe(m, (1.0,))), zero=1.0), None, "Bc"),
    "toe": (replace(_ONE, law=_beside(lambda m: _toe(m, (1.0,)))), None, BOTH),
    "pair of tendons": (replace(_ONE, law=_beside(lambda m: _toe(m, (1.0, -1.0)))), None, BOTH),
    "ripple": (replace(_ONE, law=_beside(lambda m: 3e-3 * np.sin(60.0 * m.deflection))), None, NEITHER),
    "damping by direction": (replace(_ONE, law=_beside(lambda m: 1e-3 * np.abs(m.rate))), None, ONLY_KC),
    "one sine": (replace(_ONE, kind="chirp", band=(2.0, 2.0001)), None, NEITHER),
    "steps, drive of 8 Hz": (replace(_PRBS, band=(0.2, 8.0)), None, BOTH),
    "steps, drive of 20 Hz": (replace(_PRBS, band=(0.2, 20.0), bits=14), None, BOTH),
    "steps, friction": (replace(_PRBS, law=_RUBBING), None, ONLY_KC),
    "steps, 200 Hz": (replace(_PRBS, rate=200.0), None, ONLY_KC),
    "steps, 250 Hz, friction": (replace(_PRBS, rate=250.0, law=_RUBBING), None, ONLY_KC),
    "low noise": (_QUIET, None, BOTH),
    "low noise, chirp": (replace(_QUIET, kind="chirp"), None, BOTH),
    "low noise, friction": (replace(_QUIET, law=_RUBBING), None, BOTH),
    "low noise, cubic": (replace(_QUIET, law=benches.cubic(0.3)), None, BOTH),
    "low noise, branch": (replace(_QUIET, law=benches.viscoelastic(0.2, 0.02)), None, BOTH),
    "low noise, capstan": (replace(_QUIET, law=benches.capstan(0.1)), None, BOTH),
    "low noise, lag": (replace(_QUIET, lag=2e-3), None, BOTH),
    "low noise, quadratic": (replace(_QUIET, law=benches.quadratic(1e-3)), None, BOTH),
    "100 Hz": (_SLOW, None, BOTH),
    "100 Hz, chirp": (replace(_SLOW, kind="chirp"), None, BOTH),
    "100 Hz, friction": (replace(_SLOW, law=_RUBBING), None, BOTH),
    "100 Hz, delay": (replace(_SLOW, delay=4e-3), None, BOTH),
    "100 Hz, steps": (replace(_SLOW, kind="prbs"), None, ONLY_KC),
    "tare": (_ONE, tared(0.3), BOTH),
    "tare, friction": (replace(_ONE, law=_RUBBING), tared(-0.1), BOTH),
    "long": (replace(_ONE, rate=1000.0, duration=200.0), None, BOTH),
    "ramps": (replace(_ONE, kind="ramp", band=(0.2, 4.0)), None, ONLY_KC),
    "ramps, friction": (replace(_ONE, kind="ramp", law=_RUBBING), None, ONLY_KC),
    "ramps, gear": (replace(_ONE, kind="ramp", law=benches.gear(0.04, 2e-3, 0.2, 0.01)), None, ONLY_KC),
}
"""Kinds that `benches` has not: their bench, change and what is knowable."""

KNOWABLE = {
    "Bouc-Wen 20 %": "Bc",
    "LuGre, soft bristles": "Bc",
    "yielding spring": "Bc",
    "fading 20 %, chirp": BOTH,
    "80 Hz cell, held": ONLY_KC,
    "80 Hz cell, interpolated": ONLY_KC,
    "angle frozen from 8 s": NEITHER,
    "angle wrapped": BOTH,
    "ramp": ONLY_KC,
}
"""What the recordings of `benches` identify, where it is not both: two stiffnesses, a cell slower than the motion."""


def save(path: Path, channels: Mapping[str, Array], stand: str = "", mode: str = "") -> None:
    """Write a recording; mode: of the command, "" where there is none."""
    write(path, Header(profile={"kind": "imported"} | ({"mode": mode} if mode else {}), stand_toml=stand), channels)


def _bench(bench: Bench, change: Change | None, commanded: bool, seed: int, path: Path) -> None:
    """Write the recording of a bench; commanded: with its command, which most tables do not have."""
    reading = benches.record(bench, seed)
    if change is not None:
        reading = change(reading, np.random.default_rng([seed, 44]))
    channels = {"time": reading.time, "torque": reading.torque, "dtheta": reading.deflection}
    save(path, channels | ({"command": reading.command} if commanded else {}), mode="position" if commanded else "")


def of_benches() -> Iterator[Entry]:
    """Those of `truth_benches` but for wrong units, which `hil import` refuses; pairs of effects; the kinds above."""
    commanded = itertools.cycle((True, False, False, True))  # in both halves of each two kinds

    def entry(kind: str, bench: Bench, seed: int, knowable: str, change: Change | None = None) -> Entry:
        make = functools.partial(_bench, bench, change, next(commanded), seed)
        return Entry(kind, make, bench.stiffness, bench.damping, knowable)

    for name, bench in truth_benches.BENCHES.items():
        if bench.torque_unit == bench.angle_unit == 1.0:
            plain, simulated = name.removesuffix(MUJOCO), name.endswith(MUJOCO)
            kind = "benches, MuJoCo" if simulated else f"bench {name}"
            for seed in range(1000, 1001 if simulated else 1002):
                yield entry(kind, bench, seed, KNOWABLE.get(plain, BOTH))
    for seed in range(1000, 1040):
        effects, bench = benches.drawn(seed)
        bench = replace(bench, duration=min(bench.duration, 20.0, MOST / bench.rate))
        knowable = "Bc" if "bristles" in effects else ONLY_KC if "slow cell" in effects else BOTH
        yield entry("two effects drawn", bench, seed, knowable)
    for name, (bench, change, knowable) in KINDS.items():
        for seed in range(1000, 1002):
            yield entry(name, bench, seed, knowable, change)


def of_stands() -> Iterator[Entry]:
    """The default stand, the truth study from each of its sources, and drives over their emulated wires."""
    true = default_stand.TRUTH
    for seed in range(1, 21):
        yield Entry("default stand", functools.partial(default_stand.record, seed=seed), true["Kc"], true["Bc"])
    for (source, make), case, seed in itertools.product(SOURCES.items(), CASES, range(1000, 1002)):
        if can_make(source, case):
            still, slow = case.stands_still, case.bars == UNIDENTIFIABLE
            knowable = NEITHER if still else ONLY_KC if slow else BOTH
            write_it = functools.partial(make, case, seed)
            yield Entry(f"truth, {source}", write_it, case.truth.Kc, case.truth.Bc, knowable)
    yield from of_drives()


def of_textbook() -> Iterator[Entry]:
    """Two of each effect's recordings in `textbook.py`."""
    for row in textbook.rows_of(tuple(textbook.LAWS))[: 2 * len(textbook.LAWS)]:
        true = textbook.example(row.term, row.size)
        yield Entry(f"textbook, {row.term}", functools.partial(textbook.record, row), true["Kc"], true["Bc"])


def of_pools() -> Iterator[Entry]:
    """Two recordings of one joint, of different motions, identified together."""
    for name in ("chirp", "prbs"):

        def make(path: Path, first=name) -> None:
            for number, kind in enumerate((first, "multisine")):
                _bench(replace(_ONE, kind=kind), None, False, number, _more(path) if number else path)

        yield Entry("pooled", make, _ONE.stiffness, _ONE.damping, arguments=_more(Path("{file}")).name)


def _more(path: Path) -> Path:
    """The file that is pooled with a recording."""
    return path.with_name(f"{path.name}.more.h5")


def of_drives() -> Iterator[Entry]:
    """A chirp of torque at 250 and at 100 Hz, and one of positions, whose motor torque leaves Bc unknown."""
    import chirps  # it imports the drivers' tests

    from drivers.servo import Quantity

    drives = [one for one in chirps.benches() if not one.cell and one.position != ()]  # (): simulated, loses replies
    for rate, quantity in ((250.0, Quantity.TORQUE), (100.0, Quantity.TORQUE), (250.0, Quantity.POSITION)):
        kind = f"drive, {quantity.name.lower()}, {rate:g} Hz"
        for drive in drives[::2]:
            if quantity is Quantity.TORQUE or drive.position is not None:
                record = functools.partial(chirps.recorded, drive, quantity, rate=rate)
                knowable = BOTH if rate > 100.0 and quantity is Quantity.TORQUE else ONLY_KC
                yield Entry(kind, record, *drive.truth, knowable)


def of_physics() -> Iterator[Entry]:
    """The physical simulation: 14 draws of each motion and source of the torque."""
    for (motion, source), seed in itertools.product(PAIRS, range(14)):
        drawn = draw(motion, source, seed)
        knowable = " ".join(name for name, known in (("Kc", True), ("Bc", drawn.identifies_damping)) if known)

        def make(path: Path, drawn=drawn) -> None:
            save(path, *read(drawn))

        yield Entry(f"physical, {motion}, {source}", make, *drawn.plant.truth, knowable)


def of_ramps(folder: Path) -> Iterator[Entry]:
    """Two consecutive real ramps of each table."""
    for table in sorted(folder.glob("*.csv.gz")):
        large = [one for one in real_ramps.ramps(table) if one.number >= real_ramps.PLAY]
        for ramp in large[:2]:
            where = ("--where", f"test_nr=={ramp.number}")
            words = ("import", str(table), *real_ramps.COLUMNS, *real_ramps.UNITS, *where, "-o")

            def make(path: Path, words=words) -> None:
                real_ramps.said(*words, str(path))

            yield Entry("real ramps", make, np.nan, np.nan, NEITHER, "--require Kc")


def index(entries: list[Entry]) -> list[dict[str, str]]:
    """The rows of the index, of which every second of a kind is held back."""
    rows, numbers = [], dict.fromkeys((entry.kind for entry in entries), 0)
    for entry in entries:
        number = numbers[entry.kind]
        numbers[entry.kind] += 1
        name = f"{re.sub(r'[^A-Za-z0-9]+', '-', entry.kind).strip('-')}-{number:02}.h5"
        rows.append(
            {
                "file": name,
                "kind": entry.kind,
                "half": ("seen", "held")[number % 2],
                "arguments": entry.arguments.format(file=name),
                "Kc": "" if np.isnan(entry.Kc) else f"{entry.Kc:.9g}",
                "Bc": "" if np.isnan(entry.Bc) else f"{entry.Bc:.9g}",
                "knowable": entry.knowable,
            }
        )
    return rows


def make_archive(folder: Path, entries: list[Entry]) -> None:
    """Write the index, then the recordings that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = index(entries)
    with (folder / INDEX).open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    for row, entry in zip(rows, entries, strict=True):
        path = folder / row["file"]
        if not path.exists():
            entry.make(path)


def main() -> None:
    parser = argparse.ArgumentParser(description="Make recordings with known Kc and Bc")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--ramps", type=Path, help="folder of tables of real ramps, as real_ramps.py takes it")
    options = parser.parse_args()
    entries = [
        *of_benches(),
        *of_stands(),
        *of_textbook(),
        *of_pools(),
        *of_physics(),
        *(of_ramps(options.ramps) if options.ramps else ()),
    ]
    make_archive(options.folder, entries)
    print(f"{len(entries)} recordings in {options.folder}")


if __name__ == "__main__":
    main()
