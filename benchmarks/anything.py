"""Use the whole program at random: python benchmarks/anything.py --seeds 0-99 --busy 4

Each seed draws a simulated stand (every table [sim.*]), a profile, a rate and a duration; records; damages the table
as loggers do; imports it; identifies it with the default options; writes a report, JSON and an export. It holds for
every draw: no fault of hil's own and a documented exit status; finite intervals or none; the same result with 1 and 2
workers; the recording and its own CSV within each other's intervals; no model fits worse than one that it contains;
values within given bounds. Prints a line for each breach, writes a row for each seed, and ends with status 1 on a
breach. The commands run in this process; every tenth draw identifies in a process of its own.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from hil.cli.app import run
from hil.errors import WrongUse
from hil.recording.reader import Recording
from hil.stand.file import parse
from sim_backend.parameters import SimParameters

Array = NDArray[np.float64]
Table = dict[str, Array]

STATUSES = frozenset({0, 1, 2, 3, 4})
RESULTS = Path(__file__).parent / "results" / "anything.csv"
HEAD = ("seed", "profile", "rate", "seconds", "damage", "statuses", "model", "Kc", "Bc", "trusted", "breach", "took")
PROFILES = ("chirp", "chirp", "multisine", "multisine", "chirp", "prbs", "sine", "steps", "ramp")
SWITCHED_ON = {  # what a stand has only where it is drawn: the smallest and the largest value
    "cubic": (0.01, 3.0), "gap": (1e-3, 0.05), "slack": (1e-3, 0.05), "hysteresis_torque": (1e-5, 2e-3),
    "coulomb_friction": (1e-6, 1e-3),
}  # fmt: skip
MODELS = (
    ("linear", "linear+offset"), ("linear", "linear+coulomb"), ("linear", "linear+cubic"), ("linear", "linear+skew"),
    ("linear+offset", "linear+offset+skew"), ("linear", "linear+dahl"), ("linear", "linear+backlash"),
    ("linear", "linear+delay+offset"), ("linear", "linear+quadratic"), ("linear+cubic", "linear+cubic+quintic"),
)  # fmt: skip
_TIMES = 20  # stands that are drawn until one is possible
WORSE = 1e-6  # relative difference of the fitness, above which a model fits worse than one that it contains


@dataclass
class Draw:
    """A use of the program: its random numbers, what it drew, the statuses of its commands, and the first breach."""

    seed: int
    short: bool = False
    drawn: dict[str, Any] = field(default_factory=dict)
    statuses: list[int] = field(default_factory=list)
    breach: str = ""

    def __post_init__(self) -> None:
        self.random = np.random.default_rng((53, self.seed))

    def hil(self, *words: Any, alone: bool = False) -> tuple[int, str]:
        """Run a command; return its exit status and standard output. alone: in a process of its own."""
        given = [str(word) for word in words]
        if alone:
            ended = subprocess.run([sys.executable, "-m", "hil", *given], capture_output=True, text=True, check=False)
            status, out, err = ended.returncode, ended.stdout, ended.stderr
        else:
            streams = io.StringIO(), io.StringIO()
            with contextlib.redirect_stdout(streams[0]), contextlib.redirect_stderr(streams[1]):
                status = run([*given, "--debug"])
            out, err = (stream.getvalue() for stream in streams)
        self.statuses.append(status)
        if status not in STATUSES or (alone and "Traceback (most" in err):
            places = re.findall(r'File ".*/((?:hil|ga|drivers|sim_backend)/.*?)", line (\d+)', err)
            said = [line for line in err.splitlines() if line.startswith("hil: ")][-1:]
            self.holds(False, f"hil {' '.join(given[:4])}: status {status}: {said} {places[-1:]}")
        return status, out

    def holds(self, it: bool, words: str) -> None:
        """Note a breach, if it is the first."""
        if not it and not self.breach:
            self.breach = words

    def chance(self, probability: float) -> bool:
        """Return True with this probability."""
        return bool(self.random.random() < probability)

    def one(self, values: Sequence[Any]) -> Any:
        """Return one of the values."""
        return values[int(self.random.integers(len(values)))]

    def between(self, low: float, high: float) -> float:
        """Return a number, evenly distributed in its logarithm."""
        return float(math.exp(self.random.uniform(math.log(low), math.log(high))))


def stand(draw: Draw) -> str:
    """Return a stand file of the simulator with some values of each table [sim.*] drawn."""
    source = draw.drawn["source"] = "motor" if draw.chance(0.25) else "joint"
    lines = [
        f'[stand]\nbackend = "sim"\ngear_ratio = {draw.one((1.0, 4.0, 4.0, 20.0))}\ntorque_source = "{source}"\n'
        "motor_inertia = 2e-7\nmotor_damping = 1e-7\n[limits]\ntorque = 0.1\ndeflection = 3.0\nvelocity = 100.0\n"
    ]
    hints = get_type_hints(SimParameters)
    for table in fields(SimParameters):
        values = {}
        for one in fields(hints[table.name]):
            if not isinstance(one.default, bool | float | int) or not draw.chance(0.15):
                continue
            if isinstance(one.default, bool):
                values[one.name] = str(draw.chance(0.7)).lower()
            elif one.name in SWITCHED_ON:
                values[one.name] = f"{draw.between(*SWITCHED_ON[one.name]):.4g}"
            elif one.default:
                near = draw.between(0.2, 5.0)
                values[one.name] = (
                    f"{int(one.default * near)}" if isinstance(one.default, int) else f"{one.default * near:.4g}"
                )
        lines.append(f"[sim.{table.name}]\n" + "".join(f"{name} = {value}\n" for name, value in values.items()))
    return "".join(lines)


def recorded(draw: Draw) -> bool:
    """Record on a drawn stand into r.h5; return whether there are rows."""
    for _ in range(_TIMES):
        Path("stand.toml").write_text(text := stand(draw))
        with contextlib.suppress(WrongUse):
            parse(text, "stand.toml")
            break
    low = draw.between(0.1, 3.0)
    drawn = {
        "profile": draw.one(PROFILES),
        "rate": draw.one((50, 100, 200)) if draw.short else draw.one((20, 100, 200, 500, 500, 1000)),
        "duration": round(1.5 if draw.short else draw.between(2.0, 8.0), 2),
        "fade": 0.2,
        "seed": draw.seed,
    }
    draw.drawn |= drawn
    words = [word for name, value in drawn.items() for word in (f"--{name}", value)]
    if drawn["profile"] not in {"sine", "steps", "ramp"}:
        words += ["--band", f"{low:.3g}:{min(low * draw.between(2.0, 50.0), drawn['rate'] / 4.2):.3g}"]
    if draw.chance(0.5):
        words += ["--amplitude", f"{draw.between(1e-3, 0.02):.3g}"]
    elif draw.chance(0.15):
        words += ["--mode", "position", "--amplitude", "0.2"]
    draw.hil("record", "--stand", "stand.toml", *words, "--force", "-o", "r.h5")
    return Path("r.h5").exists()


def damaged(draw: Draw, table: Table) -> Table:
    """Return the table as a logger leaves it: up to three kinds of damage."""
    table = {name: values.copy() for name, values in table.items()}
    chosen = [draw.one(list(DAMAGES)) for _ in range(draw.one((0, 1, 1, 2, 3)))]
    draw.drawn["damage"] = " ".join(chosen)
    for kind in chosen:
        kept = DAMAGES[kind](draw, table)
        if kept is not None:
            table = {name: values[kept] for name, values in table.items()}
    return table


def _a_column(draw: Draw) -> str:
    return str(draw.one(("time", "torque", "torque", "dtheta", "dtheta")))


def _rounded(draw: Draw, table: Table) -> None:
    unit = draw.one((1e-3, 1e-2, 0.0156, 0.1, 1.0))
    table["time"][:] = unit * draw.one((np.floor, np.round))(table["time"] / unit)


def _single(draw: Draw, table: Table) -> None:
    table["time"][:] = (table["time"] + draw.one((0.0, 1e5, 1.7e9))).astype(np.float32)


def _scaled(draw: Draw, table: Table) -> None:
    table[_a_column(draw)] *= draw.one((1e3, 1e-3, 57.3, -1.0, 1e6, 1e-9))


def _coarse(draw: Draw, table: Table) -> None:
    name = draw.one(("torque", "dtheta"))
    unit = float(np.ptp(table[name])) / draw.between(2.0, 1000.0)
    table[name][:] = unit * np.round(table[name] / unit) if unit > 0.0 else table[name]


def _constant(draw: Draw, table: Table) -> None:
    name, rows = _a_column(draw), _piece(draw, table)
    table[name][rows if draw.chance(0.7) else slice(None)] = table[name][rows][0]


def _spikes(draw: Draw, table: Table) -> None:
    name, count = _a_column(draw), draw.one((1, 3, 30))
    at = draw.random.integers(0, len(table[name]), count)
    table[name][at] = draw.one((0.0, -1.0, 1e3, 65535.0, 1e30))


def _missing(draw: Draw, table: Table) -> None:
    name, share = _a_column(draw), draw.one((1e-3, 0.02, 0.3, 1.0))
    table[name][draw.random.random(len(table[name])) < share] = draw.one((np.nan, np.inf))


def _dropped(draw: Draw, table: Table) -> Array:
    return np.flatnonzero(draw.random.random(len(table["time"])) > draw.one((1e-3, 0.05, 0.5)))


def _cut(draw: Draw, table: Table) -> Array:
    kept = np.ones(len(table["time"]), dtype=bool)
    kept[_piece(draw, table)] = draw.chance(0.3)
    return np.flatnonzero(kept if kept.any() and not kept.all() else kept[: draw.one((1, 5, 20, 100))])


def _repeated(draw: Draw, table: Table) -> Array:
    times = np.where(draw.random.random(len(table["time"])) < draw.one((0.01, 0.3)), draw.one((2, 5)), 1)
    return np.repeat(np.arange(len(times)), times)


def _swapped(draw: Draw, table: Table) -> Array:
    order = np.arange(len(table["time"]))
    for at in draw.random.integers(0, max(len(order) - 8, 1), draw.one((1, 5, 100))):
        order[at : at + 4] = order[at : at + 4][::-1].copy()
    return order


def _held(draw: Draw, table: Table) -> None:
    name, every = draw.one(("torque", "dtheta", "time")), draw.one((2, 5, 17, 60))
    table[name][:] = table[name][np.arange(len(table[name])) // every * every]


def _exchanged(_draw: Draw, table: Table) -> None:
    table["torque"], table["dtheta"] = table["dtheta"], table["torque"]


def _set_back(draw: Draw, table: Table) -> None:
    table["time"][_piece(draw, table)] += draw.one((-0.5, 3.0, 3600.0, -1e6))


def _piece(draw: Draw, table: Table) -> slice:
    count = len(table["time"])
    first = int(draw.random.integers(count))
    return slice(first, first + max(1, int(count * draw.one((0.01, 0.1, 0.5)))))


DAMAGES: dict[str, Callable[[Draw, Table], Any]] = {
    one.__name__[1:]: one
    for one in (
        _rounded, _single, _scaled, _coarse, _constant, _spikes, _missing, _dropped, _cut, _repeated, _swapped, _held,
        _exchanged, _set_back,
    )
}  # fmt: skip


def imported(draw: Draw, table: Table, name: str) -> bool:
    """Write the table as CSV, import it as `name`, and return whether that succeeded."""
    count = max(map(len, table.values()))
    with Path("t.csv").open("w", encoding="utf-8") as file:
        file.write("t [s],torque [N*m],angle [rad]" + (",command [N*m]" if "command" in table else "") + "\n")
        np.savetxt(file, np.column_stack([table[one] for one in table]).reshape(count, -1), "%.17g", ",")
    words = ["--time", "t", "--torque", "torque", "--dtheta", "angle"]
    words += ["--command", "command"] if "command" in table else []
    return draw.hil("import", "t.csv", *words, "--force", "-o", name)[0] == 0


def identified(draw: Draw, name: str, *words: Any, alone: bool = False) -> dict[str, Any]:
    """Return the JSON of `hil identify`; {} without a result."""
    status, out = draw.hil("identify", name, *words, "--json", alone=alone)
    found: dict[str, Any] = json.loads(out) if out.strip() else {}
    if status != 0 and not any(one.get("value") is not None for one in found.get("parameters", {}).values()):
        return {}
    for parameter, one in found["parameters"].items():
        ends = [end for end in one["ci95"] or () if end is not None]
        whole = [one["value"], *ends] if one["value"] is not None else ends
        it = all(map(math.isfinite, whole)) and len(ends) in {0, 2} and ends == sorted(ends)
        draw.holds(it, f"{parameter} of {name}: value {one['value']}, interval {one['ci95']}")
        draw.holds(status != 0 or parameter not in {"Kc", "Bc"} or len(ends) == 2, f"{parameter}: 0, no interval")
    return found


def check_workers(draw: Draw, name: str) -> None:
    """The result does not depend on the number of workers."""
    one, two = (identified(draw, name, "--workers", count) for count in (1, 2))
    for found in (one, two):
        found.pop("seconds", None)
    different = [key for key in one if one[key] != two.get(key)]
    draw.holds(one == two, f"1 and 2 workers differ in {different}")


def check_csv(draw: Draw, name: str) -> None:
    """A recording and its own CSV are within each other's intervals, where both may be trusted."""
    if draw.drawn["source"] == "motor" or draw.chance(0.5):
        draw.hil("export", name, "-o", "own.csv", "--force")
        status, _ = draw.hil(
            "import", "own.csv", *(("--stand", "stand.toml") if name == "r.h5" else ()), "-o", "own.h5"
        )
    else:
        with Recording(Path(name)) as recording:
            table = {one: recording.channel(one) for one in ("time", "torque", "dtheta", "command")}
            read = recording.channel("read_time")
        table["time"] = np.where(np.isfinite(read), read, table["time"])
        if not (np.isfinite(table["command"]).all() and np.ptp(table["command"]) > 0.0):
            table.pop("command")
        status = 0 if imported(draw, table, "own.h5") else 2
    if status:
        return
    one, two = identified(draw, name), identified(draw, "own.h5")
    for parameter in ("Kc", "Bc"):
        both = [found.get("parameters", {}).get(parameter) for found in (one, two)]
        if all(each and each["trusted"] and each["ci95"] for each in both):
            values, ends = [each["value"] for each in both], [each["ci95"] for each in both]
            it = all(low <= value <= high for value, (low, high) in zip(values, ends[::-1], strict=True))
            draw.holds(it, f"{parameter} {values[0]:.5g} in {ends[0]}, of the CSV {values[1]:.5g} in {ends[1]}")


def check_contained(draw: Draw, name: str) -> None:
    """A model fits no worse than one that it contains, on the same samples."""
    pair = draw.one(MODELS)
    small, large = (identified(draw, name, "--model", model) for model in pair)
    if small and large and small["samples"] == large["samples"]:
        fitness = [found["fitness"]["value"] for found in (small, large)]
        draw.holds(fitness[1] <= fitness[0] * (1.0 + WORSE), f"{pair}: mean error {fitness} N m")


def check_bounds(draw: Draw, name: str) -> None:
    """A value is within given bounds, or the result is refused."""
    parameter, low = draw.one(("Kc", "Bc")), draw.between(1e-5, 0.1)
    high = low * draw.between(1.1, 100.0)
    model = draw.one(("linear", "linear+offset", "linear+skew", "linear+backlash"))
    found = identified(draw, name, "--model", model, "--bounds", f"{parameter}={low:.17g}:{high:.17g}")
    value = found["parameters"][parameter]["value"] if found else low
    draw.holds(low <= value <= high, f"{model}: {parameter} {value} outside {low:g}:{high:g}")


CHECKS = (check_workers, check_csv, check_contained, check_bounds)


def used(draw: Draw) -> dict[str, Any]:
    """Use the program once in the working folder, and return the row."""
    began, found, name = time.perf_counter(), {}, "r.h5"
    if recorded(draw):
        if draw.chance(0.7):
            with Recording(Path("r.h5")) as recording:
                table = {one: recording.channel(one) for one in ("time", "torque", "dtheta")}
            name = "d.h5" if len(table["time"]) and imported(draw, damaged(draw, table), "d.h5") else ""
        if name:
            draw.hil("inspect", name)
            found = identified(draw, name, "--report", "d.html", "--force", alone=draw.seed % 10 == 9)
            if found:
                Path("d.json").write_text(json.dumps(found))
                draw.hil("export", "d.json", "-o", "d." + draw.one(("xml", "urdf", "sdf", "h")), "--force")
            draw.hil("export", name, "-o", "e." + draw.one(("csv", "csv.gz", "mat")), "--force")
            draw.hil("hysteresis", name)
            if not draw.short:
                draw.one(CHECKS)(draw, name)
    return row_of(draw, found, time.perf_counter() - began)


def row_of(draw: Draw, found: dict[str, Any], took: float) -> dict[str, Any]:
    """Return what a draw ended with, by the names of `HEAD`."""
    values = {one: found.get("parameters", {}).get(one) or {} for one in ("Kc", "Bc")}
    drawn = draw.drawn
    return {
        "seed": draw.seed,
        "profile": drawn["profile"],
        "rate": drawn["rate"],
        "seconds": drawn["duration"],
        "damage": drawn.get("damage", "-"),
        "statuses": " ".join(map(str, draw.statuses)),
        "model": found.get("model", ""),
        "Kc": values["Kc"].get("value"),
        "Bc": values["Bc"].get("value"),
        "trusted": " ".join(one for one, each in values.items() if each.get("trusted")),
        "breach": draw.breach,
        "took": round(took, 1),
    }


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep `count` processes busy inside the block; they end with it, and with this process."""
    loop = f"import os\nwhile os.getppid() == {os.getpid()}: sum(range(10**6))"
    loops = [subprocess.Popen([sys.executable, "-c", loop]) for _ in range(count)]
    try:
        yield
    finally:
        for one in loops:
            one.kill()
            one.wait()


def drawn_in(folder: Path, seed: int, *, short: bool = False) -> dict[str, Any]:
    """Use the program once in a folder, and return the row."""
    with contextlib.chdir(folder):
        return used(Draw(seed, short))


def main() -> int:
    """Print the breaches and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0-99", help="FIRST-LAST")
    parser.add_argument("--busy", type=int, default=0, help="processes that keep the computer busy beside")
    parser.add_argument("--minutes", type=float, default=math.inf, help="of wall time; then it ends with what it has")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args()
    first, last = (int(one) for one in options.seeds.split("-"))
    until, breaches, done = time.monotonic() + 60.0 * options.minutes, 0, 0
    with options.results.open("w", newline="", encoding="utf-8") as file, busy(options.busy):
        rows = csv.DictWriter(file, HEAD, lineterminator="\n")
        rows.writeheader()
        for seed in range(first, last + 1):
            if time.monotonic() > until:
                break
            with tempfile.TemporaryDirectory() as folder:
                row = drawn_in(Path(folder), seed)
            rows.writerow(row)
            file.flush()
            done += 1
            if row["breach"]:
                breaches += 1
                print(f"{seed}: {row['profile']}, {row['damage']}: {row['breach']}", flush=True)
    print(f"{done} draws, {breaches} with a breach")
    return 1 if breaches else 0


if __name__ == "__main__":
    sys.exit(main())
