"""How soon others and we come near the exact optimum of the same fitness: `python benchmarks/peers.py`.

Everything runs in one process on one thread, seed by seed and method by method in turn, so that what else the machine
does hits all alike. Times are of the processor. Needs the `bench` extra. Writes results/peers.csv and
docs/pictures/peers.png.

A clock starts where a user's would: from columns and torque as arrays and the bounds, everything imported and compiled.
Others are watched through their fitness, which ends a run when the last target is reached or the cap is over; only what
the fitness saw counts, never what a method says of itself. Ours has no fitness to watch, so a run of the public
`run_trials` first tells from its history after how many generations a target is reached, and then the clock runs around
a whole second call with that many generations, whose result must be within the target. The history is log-spaced, so
that number is up to 12 % too large.
"""

from __future__ import annotations

import argparse
import datetime
import math
import os
import platform
import statistics
import time
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from optimisers import PEERS, TARGETS, Data, Ended, Reached, Watched, recording
from page import revision, write_result

from ga.compiled import compiled_when_worth
from ga.evolution.evolution import PRESETS, Settings
from ga.trials.outcome import Trials
from ga.trials.trials import run_trials

mpl.use("Agg")
import matplotlib.pyplot as plt  # after the backend is chosen: there may be no screen

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

DOCS = Path(__file__).resolve().parent.parent / "docs"
BAR, BAR_TARGET, BAR_SAMPLES = 10.0, 1e-6, 2500
PACKAGES = ("numpy", "numba", "scipy", "pymoo", "pygad", "deap", "cma", "cmaes")
NEVER = Reached(math.inf, math.inf)

INFORMED = ", informed"
"""Behind the name of a method that is given the cube ours begins in."""

OURS: Mapping[str, Settings] = {  # every stop rule is off, ours as well as theirs
    "hil, default": replace(PRESETS["default"], tolerance=None),
    "hil, default, uninformed": replace(PRESETS["default"], tolerance=None, start="uniform"),
    "hil, paper": PRESETS["paper"],
}


@dataclass
class Outcome:
    """One run: what it reached of the targets, and whether it gave up before the last one and before the cap."""

    reached: dict[float, Reached]
    gave_up: bool = False


def watch(peer: Callable[[Watched, int], None], data: Data, seed: int, cap: float, *, informed: bool) -> Outcome:
    fitness = Watched(data, cap, informed)
    try:
        peer(fitness, seed)
    except Ended:
        return Outcome(fitness.reached)
    return Outcome(fitness.reached, gave_up=True)


def call(data: Data, settings: Settings, seed: int) -> tuple[Trials, float]:
    """Our public function for one trial in one thread, and the s it took."""
    began = time.process_time()
    found = run_trials(data.columns, data.torque, data.bounds, settings, trials=1, seed=seed, workers=1)
    return found, time.process_time() - began


def generations_needed(data: Data, settings: Settings, seed: int, cap: float) -> dict[float, int]:
    """For each target that is reached in about `cap` s the generation of the history that first shows it."""
    generations = 64.0
    while True:
        found, seconds = call(data, replace(settings, generations=int(generations)), seed)
        gaps = [data.optimum.relative_gap(fitness) for fitness in found.history.fitness[0]]
        if gaps[-1] <= TARGETS[-1] or seconds >= cap:
            break
        generations *= max(1.05, min(2.0, 1.1 * cap / seconds))
    first = {t: next((i for i, gap in enumerate(gaps) if gap <= t), None) for t in TARGETS}
    return {t: max(1, int(found.history.generation[i])) for t, i in first.items() if i is not None}


def clock(settings: Settings, data: Data, seed: int, cap: float) -> Outcome:
    reached = {}
    for target, generations in generations_needed(data, settings, seed, cap).items():
        found, seconds = call(data, replace(settings, generations=generations), seed)
        if data.optimum.relative_gap(float(found.fitness[0])) > target:
            raise RuntimeError(f"seed {seed}: {generations} generations reached {target:g} once, but not again")
        if seconds <= cap:
            reached[target] = Reached(seconds, found.evaluations)
    return Outcome(reached)


@dataclass
class Round:
    """All runs on one recording.

    shipped: s, evaluations and gap of the default preset with its own stop rule. single: s of one generation of it.
    """

    data: Data
    runs: dict[str, list[Outcome]] = field(
        default_factory=lambda: {name: [] for name in [*PEERS, *(name + INFORMED for name in PEERS), *OURS]}
    )
    shipped: list[tuple[float, float, float]] = field(default_factory=list)
    single: list[float] = field(default_factory=list)

    @property
    def each(self) -> float:
        """s of one evaluation of the fitness the others were given, the least of five."""
        units = np.full((max(1, 2_000_000 // len(self.data.torque)), 2), 0.4)
        fitness = Watched(self.data, math.inf)
        times = []
        for _ in range(5):
            began = time.process_time()
            fitness(units)
            times.append(time.process_time() - began)
        return min(times) / len(units)

    def times(self, name: str, target: float) -> list[Reached]:
        return [outcome.reached.get(target, NEVER) for outcome in self.runs[name]]

    def median(self, name: str, target: float) -> Reached:
        seconds, evaluations = zip(*self.times(name, target), strict=True)
        return Reached(statistics.median(seconds), statistics.median(evaluations))

    def take(self, seed: int, cap: float) -> None:
        """Every method once."""
        for name, peer in PEERS.items():
            self.runs[name].append(watch(peer, self.data, seed, cap, informed=False))
            self.runs[name + INFORMED].append(watch(peer, self.data, seed, cap, informed=True))
        for name, settings in OURS.items():
            self.runs[name].append(clock(settings, self.data, seed, cap))
        found, seconds = call(self.data, PRESETS["default"], seed)
        gap = self.data.optimum.relative_gap(float(found.fitness[0]))
        self.shipped.append((seconds, found.evaluations, gap))
        self.single.append(call(self.data, replace(PRESETS["default"], generations=1), seed)[1])


def measure(samples: list[int], seeds: int, cap: float) -> dict[int, Round]:
    compiled_when_worth.worth = 0.0
    Round(recording(BAR_SAMPLES)).take(0, 0.3)  # whatever is compiled or imported at a first call
    rounds = {n: Round(recording(n)) for n in samples}
    for seed in range(seeds):
        for n, one in rounds.items():
            one.take(seed, cap)
            print(f"seed {seed + 1} of {seeds}, {n:,} samples: done", flush=True)
    return rounds


def table(one: Round, cap: float) -> list[str]:
    lines = [
        "| method | " + " | ".join(f"within {power(t)}: median (worst), evaluations" for t in TARGETS) + " |",
        "| --- |" + " --- |" * len(TARGETS),
    ]
    names = sorted(one.runs, key=lambda name: [one.median(name, t).seconds for t in (1e-6, 1e-3, 1e-9)])
    return lines + [
        f"| {name} | " + " | ".join(cell(one.times(name, t), cap) for t in TARGETS) + " |" for name in names
    ]


def cell(times: list[Reached], cap: float) -> str:
    seconds, evaluations = zip(*times, strict=True)
    done = sum(math.isfinite(s) for s in seconds)
    if not done:
        return f"not in {cap:g} s"
    median, count = statistics.median(seconds), statistics.median(evaluations)
    text = f"{duration(median, cap)} ({duration(max(seconds), cap)})"
    if math.isfinite(count):
        text += f", {count:,.0f}"
    return text if done == len(times) else f"{text}; {done} of {len(times)} runs"


def duration(seconds: float, cap: float) -> str:
    if math.isinf(seconds):
        return f"> {cap:g} s"
    return f"{seconds * 1e3:.3g} ms" if seconds < 0.9995 else f"{seconds:.3g} s"


def verdict(n: int, one: Round, cap: float) -> list[str]:
    """The ratios to the fastest of the others, held against the bar where it applies, and what makes them up."""
    ours = one.median("hil, default", BAR_TARGET)
    fastest = min(PEERS, key=lambda name: one.median(name, BAR_TARGET).seconds)
    theirs = one.median(fastest, BAR_TARGET)
    if math.inf in {ours.seconds, theirs.seconds}:
        return [
            f"No ratio within {power(BAR_TARGET)} at {n:,} samples: ours or all others were not there in {cap:g} s."
        ]
    lines = [compared(one, cap, "hil, default", list(PEERS), "the fastest of the others")]
    lines.append(
        compared(one, cap, "hil, default", [name + INFORMED for name in PEERS], "the fastest that is equally informed")
    )
    lines.append(compared(one, cap, "hil, default, uninformed", list(PEERS), "the fastest of those uninformed too"))
    fixed = statistics.median(one.single)
    each = (ours.seconds - fixed) / ours.evaluations
    lines.append(
        f"Of our {duration(ours.seconds, cap)} a call that runs a single generation takes {duration(fixed, cap)}; what"
        f" is left is {quick(each)} for each of {ours.evaluations:,.0f} evaluations. {fastest} makes"
        f" {theirs.evaluations:,.0f} evaluations, of {quick(one.each)} each in the fitness it was given; the rest of"
        " its time is its own."
    )
    return lines


def compared(one: Round, cap: float, name: str, others: list[str], which: str) -> str:
    """One sentence: ours against the fastest of some others, and against the bar where it applies."""
    ours = one.median(name, BAR_TARGET).seconds
    fastest = min(others, key=lambda other: one.median(other, BAR_TARGET).seconds)
    theirs = one.median(fastest, BAR_TARGET).seconds
    ratio, n = theirs / ours, len(one.data.torque)
    if not 0.0 < ratio < math.inf:
        return f"No ratio of `{name}` to {which} within {power(BAR_TARGET)} at {n:,} samples in {cap:g} s."
    much = f"{ratio:.3g} times faster" if ratio >= 1.0 else f"{1.0 / ratio:.3g} times slower"
    text = (
        f"Within {power(BAR_TARGET)} at {n:,} samples `{name}` needs {duration(ours, cap)}, {which}, {fastest},"
        f" {duration(theirs, cap)}: **{much}**."
    )
    if n == BAR_SAMPLES and name == "hil, default":
        missed = f"missed by a factor of {BAR / ratio:.2g}"
        text += f" The bar is {BAR:g} times faster: {'met' if ratio >= BAR else missed}."
    return text


def quick(seconds: float) -> str:
    return f"{seconds * 1e6:,.{0 if seconds >= 1e-4 else 2}f} us"


def power(target: float) -> str:
    return f"1e{math.log10(target):.0f}"


def remarks(one: Round, cap: float) -> list[str]:
    seconds, evaluations, gaps = zip(*one.shipped, strict=True)
    lines = [
        "With the stop rule it is shipped with, a whole call of `default` takes"
        f" {duration(statistics.median(seconds), cap)} (worst {duration(max(seconds), cap)}),"
        f" {statistics.median(evaluations):,.0f} evaluations, and ends {statistics.median(gaps):.1e} from the optimum"
        f" (worst {max(gaps):.1e})."
    ]
    for name, outcomes in one.runs.items():
        gave_up = sum(outcome.gave_up for outcome in outcomes)
        if gave_up:
            lines.append(f"{name} ended by itself before {power(TARGETS[-1])} in {gave_up} of {len(outcomes)} runs.")
    return lines


def section(rounds: Mapping[int, Round], seeds: int, cap: float) -> str:
    lines = ["## Time to the optimum, against other optimisers", "", *PROSE, "", machine(seeds, cap), ""]
    for n, one in rounds.items():
        lines += [f"### {n:,} samples", "", *table(one, cap), ""]
        lines += [f"* {line}" for line in [*verdict(n, one, cap), *remarks(one, cap)]]
        lines += [""]
    return "\n".join(lines)


PROSE = (
    "`python benchmarks/peers.py` writes this file. All search the same box (`bounds_from_data`) for the least mean",
    "absolute error of the same recording, the paper's joint under a chirp with 0.2 mN m of noise, in one process and",
    "one thread, in turn, seed by seed. Processor times, warm, from columns and torque as arrays to the first",
    "chromosome whose error is within the target, relative to the exact optimum of `ga.lad.exact`; in brackets the",
    "worst seed. A run that was not there at the cap counts as never, in the median too. Evaluations are the median's.",
    "",
    "Ours is the time of a whole call of `run_trials` with one trial, one worker and as many generations as its own",
    "history says it takes, up to 12 % too many. The others get a compiled fitness for a generation at a time, which",
    "every one of them allows (pymoo and scipy vectorised, pygad in batches, DEAP through `map`, pycma and cmaes by",
    "ask and tell), the unit square for a box, and of several population sizes the one that served them best",
    "(`benchmarks/optimisers.py`). The CMA-ES begin at the centre of the box, which is the least-squares solution: an",
    "advantage they keep. Stop rules are off, ours too.",
    "",
    "Our `default` takes its start from the data: a cube of four standard errors around the least-squares solution,",
    "which it works out on its clock. `uninformed` is uniform in the box. For the others, `informed` means",
    "that their unit square is that cube, in its own coordinates, worked out before their clock starts.",
)


def machine(seeds: int, cap: float) -> str:
    cpu = platform.processor() or platform.machine()
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        names = [line.partition(":")[2].strip() for line in listing.read_text().splitlines() if "model name" in line]
        cpu = names[0] if names else cpu
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return (
        f"Measured on {datetime.datetime.now(tz=datetime.UTC).date()}, {cpu}, {os.cpu_count()} cores, Python"
        f" {platform.python_version()}, {packages}; seeds: {seeds}, cap {cap:g} s a run; revision {revision()}."
    )


def draw(rounds: Mapping[int, Round], cap: float) -> None:
    figure, panels = plt.subplots(
        1, len(rounds), figsize=(5.5 * len(rounds), 5), sharey=True, squeeze=False, layout="constrained"
    )
    for axes, (n, one) in zip(panels[0], rounds.items(), strict=True):
        for name in one.runs:
            median = [min(one.median(name, t).seconds, cap) for t in TARGETS]
            worst = [min(max(r.seconds for r in one.times(name, t)), cap) for t in TARGETS]
            spread = [[0.0] * len(TARGETS), [w - m for w, m in zip(worst, median, strict=True)]]
            ours = {"linewidth": 2.5, "linestyle": "-" if "default" in name else "--", "color": "black"}
            style = ours if name in OURS else {"linewidth": 1.2, "linestyle": ":" if name.endswith(INFORMED) else "-"}
            axes.errorbar(TARGETS, median, yerr=spread, marker="o", capsize=3, label=name, **style)
        axes.axhline(cap, color="grey", linestyle=":")
        axes.set(xscale="log", yscale="log", title=f"{n:,} samples", xlabel="within, relative to the optimum")
        axes.invert_xaxis()
        axes.grid(alpha=0.3)
    panels[0, 0].set_ylabel(f"time, s: median, up to the worst (dotted: the cap of {cap:g} s)")
    panels[0, -1].legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    (DOCS / "pictures").mkdir(parents=True, exist_ok=True)
    figure.savefig(DOCS / "pictures" / "peers.png", dpi=120, metadata={"Software": None})
    plt.close(figure)


def main() -> None:
    options = argparse.ArgumentParser(description="How soon others and we come near the exact optimum.")
    options.add_argument("--samples", type=int, nargs="+", default=[2500, 1_000_000], help="lengths of the recordings")
    options.add_argument("--seeds", type=int, default=5, help="runs of each method")
    options.add_argument("--cap", type=float, default=4.0, help="s after which a run counts as not having reached")
    given = options.parse_args()
    began = time.perf_counter()
    rounds = measure(given.samples, given.seeds, given.cap)
    text = section(rounds, given.seeds, given.cap)
    draw(rounds, given.cap)
    write_result("peers", text)
    print(text)
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
