"""Feed every parser of hil with bytes that nobody meant: python benchmarks/fuzz.py --inputs 100000

Needs hil[bench]. Atheris mutates good inputs towards code that was not reached yet; each parser runs in a process of
its own, so that a crash costs that parser alone. A breach is any exception but those by which hil declines an input, a
message that is not hil's own, more than a second or 512 MiB for one input. Prints a table and ends with 1 on a breach.
`--frames 50000` sends so many frames to the emulators of each family instead (emulators.py); the first that ends an
emulator, or makes its plant's state NaN, ends the program.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LONGEST, MEMORY = 5, 2048  # s for one input, MiB of the whole process
SHARED = "/dev/shm"  # noqa: S108 - a disk would only be waited for


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=500_000, help="for each parser")
    parser.add_argument("--minutes", type=float, default=600.0, help="for all parsers together")
    parser.add_argument("--only", nargs="*", default=[], help="names of parsers")
    parser.add_argument("--frames", type=int, default=0, help="for the emulators of each family, instead")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options, rest = parser.parse_known_args()
    if options.one:
        one(options.one, options.folder, rest)
    if options.frames:
        return emulated(options.frames, options.only)
    from parsers import PARSERS

    chosen = [name for name in PARSERS if not options.only or name in options.only]
    end, crashes, total = time.monotonic() + 60.0 * options.minutes, 0, 0
    print("| parser | inputs | a second | crashes |\n| --- | --- | --- | --- |")
    for number, name in enumerate(chosen):
        seconds = (end - time.monotonic()) / (len(chosen) - number)
        count, spent, found = fed(name, options.inputs, max(1, int(seconds)))
        total, crashes = total + count, crashes + bool(found)
        print(f"| {name} | {count:,} | {count / max(spent, 1e-3):,.0f} | {int(bool(found))} |", flush=True)
        if found:
            print(found, file=sys.stderr, flush=True)
    print(f"| all | {total:,} | | {crashes} |")
    return 1 if crashes else 0


def emulated(frames: int, only: list[str]) -> int:
    """Print the table of the emulators and return the exit status."""
    from emulators import FAMILIES, feed

    print("| emulators | frames | a second |\n| --- | --- | --- |")
    for name in [name for name in FAMILIES if not only or name in only]:
        began = time.monotonic()
        feed(name, frames)
        print(f"| {name} | {frames:,} | {frames / (time.monotonic() - began):,.0f} |", flush=True)
    return 0


def fed(name: str, inputs: int, seconds: int) -> tuple[int, float, str]:
    """Return how many inputs a parser read in a process of its own, s, and what it crashed with, "" for nothing."""
    with tempfile.TemporaryDirectory(dir=SHARED if os.access(SHARED, os.W_OK) else None) as folder:
        words = [f"-runs={inputs}", f"-max_total_time={seconds}", f"-timeout={LONGEST}", f"-rss_limit_mb={MEMORY}"]
        command = [
            sys.executable,
            __file__,
            "--one",
            name,
            "--folder",
            folder,
            *words,
            "-print_final_stats=1",
            f"-artifact_prefix={folder}/bad-",
        ]
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        spent = time.monotonic() - began
        counted = re.search(r"number_of_executed_units:\s*(\d+)", done.stderr) or re.search(
            r"Done (\d+) runs", done.stderr
        )
        bad = [f"{path.name}: {path.read_bytes()[:300]!r}" for path in Path(folder).glob("bad-*")]
    found = "" if not done.returncode else f"{name}: {done.stdout[-1500:]}\n{done.stderr[-1500:]}\n" + "\n".join(bad)
    return int(counted[1]) if counted else 0, spent, found


def one(name: str, folder: Path, words: list[str]) -> None:
    """Feed one parser in this process, which ends with it; all its files are in `folder`, which the parent removes."""
    import atheris

    tempfile.tempdir = str(folder)
    with atheris.instrument_imports(include=["drivers", "hil", "parsers"]):
        from parsers import PARSERS, read
    parser = PARSERS[name]
    corpus = folder / "corpus"
    corpus.mkdir()
    for number, seed in enumerate(parser.seeds):
        (corpus / str(number)).write_bytes(seed)
    atheris.Setup([sys.argv[0], *words, str(corpus)], lambda data: read(parser, data))
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
