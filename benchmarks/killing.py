"""Kill, stop or crash `hil record` at random instants and read from the drive's side when its torque ended.

python benchmarks/killing.py --times 20 [--adapter dynamixel ...] [--signal KILL|STOP|SEGV ...] [--no-guardian]
                             [--start plain stdin stdout,stderr process-1 two ...] [--python] [--patient]

Each trial is a run against an emulated drive that answers from a process of its own, over a pty (serial port, or a
serial CAN adapter) or over udp_multicast. --start: which of its standard files are closed when the recorder starts, or
that it starts as process 1 of a container (root only; "container": process 1 itself gets the signal, and only the
drive's watchdog is left), or "two": a second recorder on the same drive is refused before the first gets the signal;
--python: it calls `hil.record`. The times are those of the drive's torque log (`hil emulate --log`), on the clock of
whoever sends the signal. A stopped recorder is continued afterwards: no torque may come back. A run that ends by itself
before its signal, as where this computer is too busy for it, is started again; with --patient late ticks end no run,
and the torque-off is awaited for a minute. Prints a table for each drive, with and without its watchdog; a hand's
torque is off when that of all its axes is. Ends with status 1 where less than 95 % are off within 50 ms, one is not
within 150 ms, or torque came back. What a kill costs in rows is measured by benchmarks/row_loss.py.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from sim_backend.wire.torque_log import COLUMNS

SOON, ALWAYS, SHARE = 0.05, 0.15, 0.95
"""s within which the torque must be off, in this share of the trials and in all."""
PATIENCE = 60.0  # s for a run to begin or to end; a busy computer needs some
SETTLED = 1.0  # s after which a drive that is still on stays on, and after which its settings are restored
STANDARD = ("stdin", "stdout", "stderr")
CLI = "from hil.cli.app import main; main()"
PYTHON = (
    "import sys, hil; words = dict(zip(sys.argv[2::2], sys.argv[3::2])); "
    "hil.record(words['--stand'], words['--profile'], output=words['-o'], duration=float(words['--duration']), "
    "rate=float(words['--rate']), band=(2.0, 2.0), fade=float(words['--fade']), amplitude=float(words['--amplitude']), "
    "guardian='--no-guardian' not in sys.argv)"
)
UNHURRIED = (
    "from hil.acquisition import guard, recorder; guard._LATE_RAMP = guard._LATE_OFF = recorder._TOO_LONG = 60.0; "
)
SLCAN = 'interface = "slcan"\nchannel = "{link}"\n'


@dataclass(frozen=True, slots=True)
class Adapter:
    """A drive: the words of `hil emulate`, its table in the stand file, and its torque limit, N m.

    joints: of a hand with as many of this drive on one line, of which the trials drive one after the other; 0: no hand.
    """

    name: str
    emulate: tuple[str, ...]
    table: str
    torque: float
    joints: int = 0

    @property
    def backend(self) -> str:
        return self.emulate[0]


def _can(name: str, words: tuple[str, ...], keys: str, torque: float) -> Adapter:
    return Adapter(name, words, SLCAN + keys, torque)


ADAPTERS = (
    Adapter("hand of dynamixel X", ("dynamixel",), 'port = "{link}"\nmodel = "xl330-m288"\nwatchdog = 0.0\n', 0.03, 5),
    Adapter(
        "hand of feetech HLS",
        ("feetech",),
        'port = "{link}"\nmodel = "hls3606m"\ntorque_constant = 0.5\n',
        0.2,
        5,
    ),
    Adapter("dynamixel X", ("dynamixel",), 'port = "{link}"\nmodel = "xl330-m288"\nwatchdog = 0.1\n', 0.03),
    Adapter(
        "dynamixel X, no watchdog", ("dynamixel",), 'port = "{link}"\nmodel = "xl330-m288"\nwatchdog = 0.0\n', 0.03
    ),
    Adapter(
        "dynamixel MX", ("dynamixel", "--model", "mx-64"), 'port = "{link}"\nmodel = "mx-64"\nwatchdog = 0.0\n', 0.06
    ),
    Adapter(
        "feetech HLS",
        ("feetech", "--model", "hls3606m"),
        'port = "{link}"\nmodel = "hls3606m"\ntorque_constant = 0.5\n',
        0.2,
    ),
    _can("odrive, no watchdog", ("odrive",), "torque_constant = 0.04\nbitrate = 1000000\n", 0.4),
    _can(
        "odrive",
        ("odrive",),
        'torque_constant = 0.04\nbitrate = 1000000\nendpoints = "{folder}/flat_endpoints.json"\n',
        0.4,
    ),
    Adapter(
        "odrive on udp_multicast",
        ("odrive", "--bus", "udp_multicast", "--channel", "239.74.163.77"),
        'interface = "udp_multicast"\nchannel = "239.74.163.77"\ntorque_constant = 0.04\nbitrate = 1000000\n',
        0.4,
    ),
    _can("mit Damiao", ("mit", "--model", "dm-j4310"), 'model = "dm-j4310"\nwatchdog = 0.1\n', 2.0),
    _can("mit Damiao, no watchdog", ("mit", "--model", "dm-j4310"), 'model = "dm-j4310"\nwatchdog = 0.0\n', 2.0),
    Adapter(
        "mit Damiao, its own adapter",
        ("mit", "--model", "dm-j4310", "--bus", "damiao"),
        'interface = "damiao"\nchannel = "{link}"\nmodel = "dm-j4310"\nwatchdog = 0.0\n',
        2.0,
    ),
    _can("mit AK", ("mit", "--model", "ak80-9"), 'model = "ak80-9"\n', 2.0),
    _can("robstride", ("robstride",), 'model = "rs00"\nwatchdog = 0.1\n', 2.0),
    _can("robstride, no watchdog", ("robstride",), 'model = "rs00"\nwatchdog = 0.0\n', 2.0),
    _can("moteus", ("moteus",), "watchdog = 0.1\n", 0.4),
    _can("cia402 EPOS4", ("cia402",), 'profile = "epos4"\nwatchdog = 0.1\n', 0.04),
    _can("cia402 EPOS4, no watchdog", ("cia402",), 'profile = "epos4"\nwatchdog = 0.0\n', 0.04),
    Adapter(
        "commander",
        ("commander", "--firmware", "2.4-watchdog"),
        'port = "{link}"\ntorque_constant = 0.0145\nwatchdog = 0.1\n',
        4e-3,
    ),
    Adapter(
        "commander, no watchdog", ("commander",), 'port = "{link}"\ntorque_constant = 0.0145\nwatchdog = 0.0\n', 4e-3
    ),
)

STAND = """
[stand]
backend = "{backend}"
motor_inertia = 3.2e-6
torque_stays_on_if_host_dies = true
[limits]
torque = {torque}
deflection = "20 rad"
velocity = 200.0
temperature = 80.0
[{backend}]
"""


class How(NamedTuple):
    """The name of a signal without SIG, and how the recorder that gets it is started: see `started_by`."""

    signal: str
    start: str


@dataclass(frozen=True, slots=True)
class Trial:
    """off: s from the signal to the end of the torque, infinity where it went on. again: whether torque came back."""

    off: float
    again: bool


class Log:
    """What is added to the torque log of a drive from now on."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._begin = path.read_bytes().rfind(b"\n") + 1 if path.exists() else 0

    def rows(self, since: float = -math.inf) -> list[tuple[float, float, bool]]:
        """Return time, torque commanded and whether it is off in all drives, of the rows from `since` s on.

        A commanded torque of zero alone is no end: a sine passes through it.
        """
        with self._path.open(encoding="ascii", newline="") as file:
            file.seek(self._begin)
            lines = [line for line in csv.DictReader(file, COLUMNS) if line["watchdog"] not in (None, COLUMNS[-1])]
        rows, is_off = [], dict[str, bool]()
        for line in lines:
            commanded = float(line["commanded_Nm"])
            tripped = line["watchdog"] == "tripped" and commanded == 0.0
            is_off[line["drive"]] = line["enabled"] == "0" or tripped
            rows.append((float(line["time_s"]), commanded, all(is_off.values())))
        return [one for one in rows if one[0] >= since]

    def ended(self, since: float) -> tuple[float, bool]:
        """Return the time of the first torque-off from `since` s on, infinity without one; whether torque came back."""
        states = [(at, off) for at, _, off in self.rows(since)]
        first = next((place for place, (_, off) in enumerate(states) if off), None)
        if first is None:
            return math.inf, False
        return states[first][0], not all(off for _, off in states[first:])

    def off_at(self, time_: float) -> bool:
        """Return whether the torque was off at a time, s."""
        before = [off for at, _, off in self.rows() if at < time_]
        return not before or before[-1]


@contextmanager
def emulated(adapter: Adapter, link: Path, log: Path) -> Iterator[None]:
    """Run `hil emulate` of a drive, or of a hand, as long as the `with` lasts."""
    place = [] if "--channel" in adapter.emulate else ["--link", str(link)]
    place += ["--hand", str(log.parent / "stand.toml")] if adapter.joints else []
    words = [sys.executable, "-m", "hil", "emulate", *adapter.emulate, *place, "--log", str(log)]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            said = process.stderr.readline()
            if not said.startswith("Emulating"):
                raise RuntimeError(f"{adapter.name}: {said}")
            yield
        finally:
            process.kill()


def started_by(start: str) -> list[str]:
    """Return the words that start the words behind them: "plain", as process 1, or with standard files closed."""
    if start in {"plain", "two"}:
        return []
    if start in {"process-1", "container"}:
        return ["unshare", "--pid", "--fork", "--mount-proc"]
    closed = " ".join(f"{STANDARD.index(name)}>&-" for name in start.split(","))
    return ["sh", "-c", f'exec "$0" "$@" {closed}']


def process_of(start: str, process: int) -> int:
    """Return the process that gets the signal: the one that records, or process 1 of its container."""
    for _ in range({"process-1": 2, "container": 1}.get(start, 0)):
        process = int(Path(f"/proc/{process}/task/{process}/children").read_text().split()[0])
    return process


def recorded(
    adapter: Adapter, stand: Path, output: Path, start: str, settings: argparse.Namespace
) -> subprocess.Popen[bytes]:
    """Start `hil record` with a sine of 2 Hz, or `hil.record`."""
    sine = ["--profile", "sine", "--band", "2", "--fade", "0.2", "--amplitude", str(0.45 * adapter.torque)]
    program = f"{UNHURRIED if settings.patient else ''}{PYTHON if settings.python else CLI}"
    words = [sys.executable, "-c", program, "record", "--stand", str(stand), "-o", str(output), "--duration", "60"]
    words += ["--rate", str(settings.rate), *sine, *(["--no-guardian"] if settings.no_guardian else [])]
    if adapter.joints:
        words += ["--joint", f"joint-{1 + int(output.stem.removeprefix('run')) % adapter.joints}"]
    with output.with_suffix(".log").open("wb") as errors:
        nothing = subprocess.DEVNULL  # in a terminal `hil record` would ask
        return subprocess.Popen([*started_by(start), *words], stdin=nothing, stdout=nothing, stderr=errors)


class EndedBefore(Exception):
    """A run ended by itself before its signal, or was about to: its torque was off."""


def trial(adapter: Adapter, output: Path, how: How, wait: float, settings: argparse.Namespace) -> Trial:
    """Start a run, send it a signal `wait` s after its torque has begun, and look at the drive."""
    log, threshold = Log(output.parent / "torque.csv"), 0.25 * adapter.torque
    begun = time.monotonic()
    stand = output.parent / "stand.toml"
    process = recorded(adapter, stand, output, how.start, settings)
    try:
        await_torque(log, process, begun, threshold)
        if how.start == "two":
            refused(recorded(adapter, stand, output.with_suffix(".second.h5"), "plain", settings), process)
        time.sleep(wait)
        if process.poll() is not None:
            raise EndedBefore
        recorder = process_of(how.start, process.pid)
        sent = time.monotonic()  # taken first: the guardian may have acted before the next line ends
        os.kill(recorder, getattr(signal, f"SIG{how.signal}"))
        while settings.patient and math.isinf(log.ended(sent)[0]) and time.monotonic() < sent + PATIENCE:
            time.sleep(0.05)
        time.sleep(SETTLED)
        if log.off_at(sent):
            raise EndedBefore
        off = log.ended(sent)[0] - sent
        if how.signal == "STOP":
            os.kill(recorder, signal.SIGCONT)
            process.wait(PATIENCE)
        return Trial(off, log.ended(sent)[1])
    finally:
        process.kill()
        process.wait()


def refused(second: subprocess.Popen[bytes], first: subprocess.Popen[bytes]) -> None:
    """Wait until the second recorder has ended. Raises EndedBefore where the first ends before that."""
    try:
        while second.poll() is None:
            if first.poll() is not None:
                raise EndedBefore
            time.sleep(0.02)
        if not second.returncode:
            raise RuntimeError("the second recorder was not refused")
    finally:
        second.kill()
        second.wait()


def await_torque(log: Log, process: subprocess.Popen[bytes], begun: float, torque: float) -> None:
    """Wait until the drive has commanded `torque` N m. Raises EndedBefore where the run ends first."""
    while not any(abs(commanded) > torque for _, commanded, _ in log.rows(begun)):
        if process.poll() is not None or time.monotonic() > begun + PATIENCE:
            raise EndedBefore
        time.sleep(0.02)


def measured(adapter: Adapter, how: How, settings: argparse.Namespace) -> list[Trial]:
    """Return the trials with one drive and one signal. Raises RuntimeError where its runs do not begin."""
    rng = random.Random(f"{settings.seed} {adapter.name} {how.signal}")  # noqa: S311 - no secret
    trials: list[Trial] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(adapter, folder, folder / "tty")
        with emulated(adapter, folder / "tty", folder / "torque.csv"):
            for number in range(10 + 3 * settings.times):
                output = folder / f"run{number}.h5"
                with suppress(EndedBefore):
                    trials.append(trial(adapter, output, how, rng.uniform(0.0, 0.8), settings))
                if len(trials) == settings.times:
                    return trials
        raise RuntimeError(f"{adapter.name}: {output.with_suffix('.log').read_text(encoding='utf-8')}")


def prepare(adapter: Adapter, folder: Path, link: Path) -> None:
    """Write the stand file, and the vendor's file of an ODrive."""
    if "flat_endpoints" in adapter.table:
        import json

        from sim_backend.wire.odrive.endpoints import flat_endpoints

        (folder / "flat_endpoints.json").write_text(json.dumps(flat_endpoints("0.6.10")))
    text = STAND.format(backend=adapter.backend, torque=adapter.torque) + adapter.table.format(link=link, folder=folder)
    if adapter.joints:
        text = f'[hand]\nbackend = "{adapter.backend}"\n' + text.replace(f'backend = "{adapter.backend}"\n', "")
        joints = range(1, adapter.joints + 1)
        text += "".join(f'[[joint]]\nname = "joint-{one}"\n[joint.{adapter.backend}]\nid = {one}\n' for one in joints)
    (folder / "stand.toml").write_text(text)


def row(adapter: Adapter, how: How, trials: list[Trial]) -> tuple[str, bool]:
    """Return a line of the table, and whether it holds the bar."""
    offs = sorted(one.off for one in trials)
    soon, always = (sum(off <= bar for off in offs) for bar in (SOON, ALWAYS))
    again = sum(one.again for one in trials)
    good = soon >= SHARE * len(offs) and always == len(offs) and not again
    cells = [
        adapter.name if how.start == "plain" else f"{adapter.name}; {how.start}",
        how.signal,
        str(len(offs)),
        f"{statistics.median(offs) * 1e3:.1f}",
        f"{offs[-1] * 1e3:.1f}" if math.isfinite(offs[-1]) else "stays on",
        f"{soon}",
        f"{always}",
        f"{again}",
        "yes" if good else "NO",
    ]
    return "| " + " | ".join(cells) + " |", good


HEADINGS = (
    "drive",
    "signal",
    "trials",
    "off, median ms",
    "worst ms",
    "within 50 ms",
    "within 150 ms",
    "torque came back",
    "bar held",
)
HEAD = f"| {' | '.join(HEADINGS)} |\n|{' --- |' * len(HEADINGS)}"


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=20, help="trials for each drive and signal")
    parser.add_argument("--adapter", nargs="*", default=[], help="drives whose name begins so (all)")
    parser.add_argument("--signal", nargs="*", default=["KILL"], help="KILL, STOP, SEGV, ...: names without SIG")
    parser.add_argument("--start", nargs="*", default=["plain"], help="plain, stdin, stdin,stdout, ..., process-1")
    parser.add_argument("--python", action="store_true", help="by hil.record instead of hil record")
    parser.add_argument("--rate", type=float, default=100.0, help="Hz")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-guardian", action="store_true", help="to see what the drives do by themselves")
    parser.add_argument("--patient", action="store_true", help="for a busy computer: what is late ends nothing")
    settings = parser.parse_args()
    wanted = tuple(settings.adapter) or ("",)
    chosen = [adapter for adapter in ADAPTERS if adapter.name.startswith(wanted)]
    print(f"{settings.times} trials each, {settings.rate:g} Hz, load {os.getloadavg()[0]:.1f}\n\n{HEAD}", flush=True)
    held = True
    for adapter in chosen:
        for how in (How(word, start) for start in settings.start for word in settings.signal):
            line, good = row(adapter, how, measured(adapter, how, settings))
            held = held and good
            print(line, flush=True)
    print("\nheld" if held else "\nBREACH")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
