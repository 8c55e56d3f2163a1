"""Walk at random through the command line: python benchmarks/walk.py --times 2000

Each step is a command with options, values and files drawn at random, most of them wrong: other kinds of files, empty
and endless ones, rows that no bench has, numbers without end, narrow terminals, ASCII, a closed pipe, no home. Each
must end with a sentence of hil's own and a status that the help names. Prints a table of commands and statuses, and
ends with status 1 on a breach: a fault in hil itself, another program's words, a temporary name, a crash, a hang.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import math
import os
import random
import re
import shlex
import shutil
import signal
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import typer
from forked import Ended, in_a_copy
from odd_files import make_files

from hil.cli.app import app, run

STATUSES = frozenset({0, 1, 2, 3, 4, 130})
FORBIDDEN = re.compile(
    r"fault in hil itself|Traceback|\[Errno|pydantic|Input should|validation error|<list\[|\.hil-[0-9a-f]{8}|"
    r"\bPosixPath|<class |object at 0x|\bnumpy\.|\bndarray\b|errors\.pydantic|Exception ignored|Warning:|Errno \d"
)
NUMBERS = (
    "0", "-1", "1", "2", "0.5", "1.5", "10", "nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "1e9", "5e-324",
    "99999999999999999999999", "", " ", "abc", "5 deg", "50mm", "1 N*m", "1 mN*m", "3 kg", "0.1:15", "15:0.1", "nan:1",
    "1:", ":", "1:2:3", "0x10", "1_0", "\u0661", "\u00b5", "1,5", "--", "-", "\x1b[31mred", "a\x00b"[:1], "%s", "{}",
)  # fmt: skip
WORDS = {
    "--profile": ("chirp", "multisine", "prbs", "ramp", "steps", "sine", "file", "logchirp", "nothing"),
    "--mode": ("torque", "position"),
    "--backend": ("sim", "sim", "sim", "replay", "dynamixel", "odrive", "nothing"),
    "--duration": ("0.6", "1", "2", "0.001", "3e-3 min"),
    "--rate": ("100", "500", "1 kHz", "20", "1e5"),
    "--fade": ("0.1", "0", "0.5", "1e9"),
    "--amplitude": ("0.006", "0.001", "1 mN*m", "0.01 rad", "1e-12"),
    "--band": ("0.5:10", "1:20", "5", "1e-9:1", "1:1e9"),
    "--model": (
        "auto", "linear", "linear+offset", "linear+skew", "linear+coulomb", "linear+backlash", "linear+cubic", "offset",
        "linear+", "+", "linear+linear", "nowhere.py:Model", "text.csv:Model", "sls", "linear+slack",
    ),
    "--bounds": ("Kc=0.001:1", "Bc=0:1", "Kc=1:0.1", "Kc=5:5", "Kc=-1e300:1e300", "Kc", "skew=-1:1", "Kc=nan:1"),
    "--preset": ("default", "paper"),
    "--selection": ("tournament", "roulette", "all"),
    "--require": ("Kc", "Bc", "both"),
    "--format": ("csv", "mat", "parquet", "mcap", "mujoco", "urdf", "sdf", "c", "json", "doc"),
    "--time": ("t", "t [s]", "none"), "--torque": ("q", "t"), "--dtheta": ("p", "t"), "--dtheta-dot": ("p", "q"),
    "--command": ("q", "p", "t"), "--command-unit": ("A", "N*m", "s"),
    "--motor-torque": ("q",), "--motor-position": ("p",), "--time-unit": ("s", "ms", "N*m"),
    "--torque-unit": ("N*m", "mN*m", "deg"), "--dtheta-unit": ("rad", "deg", "s"),
    "--where": ("t>1", "p==0", "q", "nope==1", "t==nan", "t<-1e300"), "--topic": ("/joint_states", ""),
    "--link": ("./tty", "good.h5", "folder"),
    "--kc": ("0.3", "20 mN*m/rad"), "--bc": ("3e-3", "0.2 mN*m*s/rad"), "--torque-noise": ("1e-3",),
    "--evaluations": ("1000", "200"), "--trials": ("1", "2"), "--generations": ("3", "20"), "--population": ("3", "10"),
    "--workers": ("1", "2"), "--seed": ("0", "7", "9223372036854775807"), "--generation": ("1",),
    "--kind": ("fixed",), "--samples": ("10",),
}  # fmt: skip
OUTPUTS = (
    "new.h5", "new.csv", "new.png", "new.html", "new.mat", "new.xml", "new.json", "new.mcap", "new.parquet", "new.rrd",
    "new", "good.h5", "folder", "fifo", "/dev/null", "nowhere/new.h5", "link", "loop", "a\x1bb.h5", "n" * 300 + ".h5",
)  # fmt: skip
WRITTEN = frozenset({"--output", "-o", "--report", "--plot", "--log", "--rerun"})
READ = frozenset({"--stand", "--setpoints", "--faults", "--fixture", "--checkpoint", "--points", "--recording"})
HEAVY = {"replicate": ["--evaluations", "200", "--trials", "1"], "identify": ["--workers", "1"]}
ON_A_FILE = (
    "inspect FILE", "inspect FILE --verify --json", "inspect FILE --plot new", "identify FILE --workers 1",
    "identify FILE --model linear --report new.html --workers 1", "identify good.h5 FILE --workers 1 --json",
    "identify good.h5 --fixture FILE --workers 1", "identify good.h5 --checkpoint FILE --workers 1",
    "identify --each FILE good.h5 --model linear --workers 1", "compare good.h5 FILE --workers 1",
    "report FILE -o new.html --workers 1", "view FILE -o new.rrd", "recover FILE -o new.h5", "recover FILE",
    "import FILE -o new.h5 --time t --torque q --dtheta p", "import sine.csv -o new.h5 --stand FILE",
    "import FILE -o new.h5 --time t --torque q --dtheta p --torque-unit mN*m --dtheta-unit deg --time-unit s",
    "export FILE -o new.csv", "export FILE -o new.mat", "export FILE -o new.mcap", "export FILE -o new.xml",
    "export good.h5 -o FILE --format csv --force", "campaign FILE --yes", "campaign FILE --dry-run",
    "design --stand FILE --model linear", "design --backend sim --profile file --setpoints FILE --model linear",
    "doctor FILE", "calibrate torque FILE --yes", "calibrate torque sim.toml --arm 50mm --yes --points FILE",
    "calibrate fixture FILE --yes", "calibrate fixture sim.toml --recording FILE --yes", "calibrate zero FILE --yes",
    "record --backend replay FILE --duration 0.6 --fade 0.1 -o new.h5", "record --stand FILE --duration 0.6 --fade 0.1",
    "record --backend sim --profile file --setpoints FILE --fade 0.1 -o new.h5",
    "record --backend sim --faults FILE --duration 0.6 --fade 0.1 -o new.h5",
    "record --backend sim --duration 0.6 --fade 0.1 --force -o FILE", "stand new --yes --backend sim --force -o FILE",
)  # fmt: skip
"""Commands that each file is put into, where one word of them is FILE."""
SLOW = frozenset({"demo", "replicate", "campaign"})
ENDLESS = frozenset({"emulate"})


class Step(NamedTuple):
    """A command and where it runs."""

    words: list[str]
    columns: int
    encoding: str
    closed_pipe: bool
    home: bool
    humble: bool  # without root's rights, in a folder that cannot be written


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=math.inf, help="of wall time; then it ends with what it has")
    parser.add_argument("--only", nargs="*", help="these commands alone")
    parser.add_argument("--files", action="store_true", help="put every file into every command, in an order of chance")
    parser.add_argument("--show", action="store_true", help="print every step and what it said")
    options = parser.parse_args()
    until = time.monotonic() + 60.0 * options.minutes
    counts: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "files"
        make_files(home)
        warm(home)
        for number in range(options.times):
            if time.monotonic() > until:
                break
            generator = random.Random(f"{options.seed}, {number}")  # noqa: S311 - no secret
            draw = partial(on_a_file, number=number) if options.files else drawn
            step = draw(generator, home, only=options.only)
            ended, reason = walked(step, home, Path(folder) / f"step{number}")
            counts[command_of(step.words), reason or f"status {ended.status}"] += 1
            if reason or options.show:
                print(f"{number}: {shlex.join(['hil', *step.words])!r} {step[1:]} {ended.status}\n  {reason}")
                print("  " + (ended.out[-300:] + ended.err[-1500:]).strip().replace("\n", "\n  "), flush=True)
    return table(counts)


def table(counts: Counter[tuple[str, str]]) -> int:
    """Print what each command ended with, and return the exit status."""
    print("| command | steps | statuses | breaches |\n| --- | --- | --- | --- |")
    breaches = 0
    for command in sorted({command for command, _ in counts}):
        ends = {end: count for (name, end), count in counts.items() if name == command}
        good = {end.removeprefix("status "): count for end, count in ends.items() if end.startswith("status ")}
        wrong = sum(ends.values()) - sum(good.values())
        breaches += wrong
        statuses = ", ".join(f"{end}: {good[end]}" for end in sorted(good, key=int))
        print(f"| {command} | {sum(ends.values())} | {statuses} | {wrong} |")
    print(f"{counts.total()} steps, " + ("no breach" if not breaches else f"{breaches} BREACHES"))
    return 1 if breaches else 0


def warm(home: Path) -> None:
    """Load what the commands need, once for all copies."""
    ended = Path.cwd()
    os.chdir(home)
    stdout, sys.stdout = sys.stdout, open(os.devnull, "w")  # noqa: SIM115, PTH123
    stderr, sys.stderr = sys.stderr, sys.stdout
    try:
        run(["identify", "good.h5", "--workers", "1", "--report", "warm.html"])
        run(["inspect", "good.h5", "--plot", "warm"])
        run(["design", "--backend", "sim", "--duration", "1", "--model", "linear"])
    finally:
        sys.stdout, sys.stderr = stdout, stderr
        os.chdir(ended)
    gc.freeze()


def command_of(words: list[str]) -> str:
    """Return the name of the command in a step."""
    return " ".join(words[:2] if words[:1] and words[0] in {"stand", "calibrate"} else words[:1])


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every command of typer's with its name."""
    for name, one in group.commands.items():
        if hasattr(one, "commands"):
            yield from commands(one, (*path, name))
        else:
            yield (*path, name), one


COMMANDS = list(commands(typer.main.get_command(app)))


def on_a_file(generator: random.Random, home: Path, *, number: int, only: Sequence[str] | None) -> Step:
    """Return the step with a number of those that put a file into a command."""
    every = [
        (line, file)
        for line in ON_A_FILE
        if only is None or line.split()[0] in only
        for file in sorted(one.name for one in home.iterdir())
    ]
    random.Random(1).shuffle(every)  # noqa: S311 - no secret
    line, file = every[number % len(every)]
    words = [file if word == "FILE" else word for word in line.split()]
    return Step(words, generator.choice((40, 80, 120)), "utf-8", closed_pipe=False, home=True, humble=False)


def drawn(generator: random.Random, home: Path, only: Sequence[str] | None) -> Step:
    """Return a step of any command, or of those in `only`."""
    chosen = [pair for pair in COMMANDS if only is None or " ".join(pair[0]) in only]
    path, command = generator.choices(chosen, [0.1 if " ".join(name) in SLOW else 1.0 for name, _ in chosen])[0]
    files = sorted(one.name for one in home.iterdir())
    words = list(path)
    options = [one for one in command.params if one.param_type_name == "option" and "--help" not in one.opts]
    for one in command.params:
        if one.param_type_name == "argument" and generator.random() < 0.95:
            count = 1 if one.nargs == 1 else generator.choice((1, 1, 2, 3))
            words += [argument(generator, one.name, files) for _ in range(count)]
    required = [one for one in options if one.required or (one.name in {"output"} and generator.random() < 0.6)]
    few = generator.choice((0, 1, 1, 2, 3, 5, 12))
    for one in [*required, *generator.sample(options, min(few, len(options)))]:
        words += option(generator, one, files)
    if path[0] in {"record", "design"} and generator.random() < 0.7:
        words += ["--backend", "sim", "--duration", "0.6", "--fade", "0.1"]
    words += [] if generator.random() < 0.2 else HEAVY.get(path[0], [])
    return Step(
        words,
        generator.choice((20, 25, 40, 80, 80, 80, 132, 200)),
        generator.choice(("utf-8", "utf-8", "utf-8", "ascii", "latin-1")),
        generator.random() < 0.05,
        generator.random() > 0.1,
        generator.random() < 0.1,
    )


def argument(generator: random.Random, name: str, files: list[str]) -> str:
    """Return a value for an argument."""
    if name in {"family", "kind"}:
        return generator.choice(
            ("dynamixel", "feetech", "cia402", "odrive", "mit", "robstride", "moteus", "commander", "loadcell", "x")
        )
    return generator.choice((*files, *files, "missing.h5", "", "-", "/dev/zero", "/dev/null", "/", ".", "*.h5"))


def option(generator: random.Random, one: Any, files: list[str]) -> list[str]:
    """Return the words of an option."""
    name = generator.choice(one.opts)
    long = next((other for other in one.opts if other.startswith("--")), name)
    if one.is_flag:
        return [name]
    chance = generator.random()
    if long in READ | {"--output"} and chance < 0.15:
        return [name, generator.choice(NUMBERS)]
    if long in READ:
        return [name, generator.choice(files)]
    if long in WRITTEN:
        return [name, generator.choice(OUTPUTS)]
    if long in WORDS and chance < 0.6:
        return [name, generator.choice(WORDS[long])]
    return [name, generator.choice(NUMBERS)]


def walked(step: Step, home: Path, place: Path) -> tuple[Ended, str]:
    """Return how a step ended, and why that is a breach, "" where it is none."""
    shutil.copytree(home, place, symlinks=True, copy_function=os.link)
    os.mkfifo(place / "fifo")
    patience = 4.0 if step.words[0] in ENDLESS else 120.0

    def work() -> int:
        os.chdir(place)
        os.environ["COLUMNS"] = str(step.columns)
        os.environ["LANG"] = "C" if step.encoding == "ascii" else "C.UTF-8"
        os.environ["XDG_STATE_HOME"] = str(place)
        if not step.home:
            for name in ("HOME", "XDG_STATE_HOME", "XDG_CACHE_HOME"):
                os.environ.pop(name, None)
        if step.humble:
            place.chmod(0o555)
            without_privileges()
        sys.argv = ["hil", *step.words]
        return run(step.words)

    try:
        ended = in_a_copy(work, patience=patience, memory=3 << 29, encoding=step.encoding, closed_pipe=step.closed_pipe)
    finally:
        shutil.rmtree(place, ignore_errors=True)
    return ended, breach(step, ended)


def without_privileges() -> None:
    """Give up root's right to read and write what the permissions forbid."""
    header, nothing = struct.pack("Ii", 0x20080522, 0), struct.pack("6I", *6 * [0])
    ctypes.CDLL(None).capset(header, nothing)


def breach(step: Step, ended: Ended) -> str:
    """Return why an end is a breach."""
    said = FORBIDDEN.search(ended.out.replace("\x1b", "") + ended.err)
    if said:
        return f"SAYS {said[0]!r}"
    if ended.status == -signal.SIGKILL or (ended.interrupted and step.words[0] not in ENDLESS):
        return "HANGS"
    if ended.status not in STATUSES:
        return f"ENDS WITH {ended.status}"
    if ended.status and not ended.err.strip():
        return "SAYS NOTHING"
    return ""


if __name__ == "__main__":
    sys.exit(main())
