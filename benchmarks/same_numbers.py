"""Compare the numbers of `hil identify` between two revisions, on ten recordings that the older one makes.

    python benchmarks/same_numbers.py 37c3dc9            # against this checkout
    python benchmarks/same_numbers.py 37c3dc9 main --table docs/same_numbers.md

Every number of the JSON must be the same to the last digit; times and words are not compared. The older JSON is read
through the reader that this checkout has for it, so that renamed keys meet. Exits 1 where a number differs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hil.report.identification_json import upgraded

ROOT = Path(__file__).resolve().parent.parent
STAND = """
[stand]
name = "{name}"
backend = "sim"
gear_ratio = 4.0
motor_inertia = 2.0e-7
motor_damping = 1.0e-7
torque_source = "{source}"
[limits]
torque = 0.03
deflection = 1.0
velocity = 100.0
[sim.coupling]
{coupling}
"""
STANDS = {
    "joint": STAND.format(name="joint", source="joint", coupling=""),
    "motor": STAND.format(name="motor", source="motor", coupling=""),
    "stiff": STAND.format(name="stiff", source="joint", coupling="stiffness = 0.06\ndamping = 4.0e-4"),
    "backlash": STAND.format(name="backlash", source="joint", coupling="gap = 0.02"),
}
RECORDINGS: dict[str, tuple[str, list[str]]] = {
    "chirp": ("joint", ["--profile", "chirp"]),
    "multisine": ("joint", ["--profile", "multisine"]),
    "prbs": ("joint", ["--profile", "prbs", "--duration", "10"]),
    "steps": ("joint", ["--profile", "steps"]),
    "ramp": ("joint", ["--profile", "ramp", "--duration", "40", "--rate", "100"]),
    "sine": ("joint", ["--profile", "sine", "--duration", "8"]),
    "motor": ("motor", ["--profile", "multisine", "--rate", "1000", "--duration", "10"]),
    "stiff": ("stiff", ["--profile", "chirp", "--band", "0.5:40", "--rate", "1000", "--duration", "10"]),
    "backlash": ("backlash", ["--profile", "multisine", "--duration", "10"]),
    "short": ("joint", ["--profile", "chirp", "--duration", "3"]),
}
TIMES = ("seconds",)


def main() -> None:
    """Record, identify with both revisions, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old")
    parser.add_argument("new", nargs="?", help="this checkout where it is left out")
    parser.add_argument("--only", nargs="*", choices=RECORDINGS, default=list(RECORDINGS))
    parser.add_argument("--table", type=Path, help="also write the table there (Markdown)")
    words = parser.parse_args()
    with checkout(words.old) as old, checkout(words.new) as new, tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name in words.only:
            record(old, folder, name)
        rows = [(name, *compared(old, new, folder, name)) for name in words.only]
    lines = ["| recording | numbers compared | that differ |", "| --- | --- | --- |"]
    lines += [f"| {name} | {count} | {', '.join(wrong) or 'none'} |" for name, count, wrong in rows]
    print("\n".join(lines))
    if words.table is not None:
        words.table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.exit(any(wrong or not count for _, count, wrong in rows))


@contextmanager
def checkout(revision: str | None) -> Iterator[Path]:
    """Yield a folder with the sources of `revision`, this checkout for None."""
    if revision is None:
        yield ROOT
        return
    with tempfile.TemporaryDirectory() as folder:
        git("worktree", "add", "--quiet", "--detach", folder, revision)
        try:
            yield Path(folder)
        finally:
            git("worktree", "remove", "--force", folder)


def git(*words: str) -> None:
    """Run git in this repository."""
    subprocess.run(["git", *words], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)  # noqa: S607


def hil(sources: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run `hil` from `sources` in `folder`."""
    code = "import sys; sys.path.insert(0, sys.argv.pop(1)); from importlib import import_module as load\n"
    code += "try: main = load('hil.cli.app').main\nexcept ImportError: main = load('hil.cli').main\nmain()"
    command = [sys.executable, "-P", "-c", code, str(sources), *words]
    env = os.environ | {"PYTHONPATH": str(sources)}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)


def record(old: Path, folder: Path, name: str) -> None:
    """Make one recording with the older revision."""
    stand, words = RECORDINGS[name]
    (folder / f"{stand}.toml").write_text(STANDS[stand], encoding="utf-8")
    done = hil(old, folder, "record", "--stand", f"{stand}.toml", "--seed", "1", *words, "-o", f"{name}.h5")
    if not (folder / f"{name}.h5").exists():
        sys.exit(f"{name}: not recorded: {done.stderr}")


def compared(old: Path, new: Path, folder: Path, name: str) -> tuple[int, list[str]]:
    """Return how many numbers were compared, and the keys of those that differ."""
    words = ("identify", f"{name}.h5", "--json", "--seed", "0")
    before, after = (numbers(upgraded(json.loads(hil(one, folder, *words).stdout))) for one in (old, new))
    wrong = [f"{key} ({value}, {after.get(key)})" for key, value in sorted(before.items()) if after.get(key) != value]
    return len(before), wrong


def numbers(table: Any, prefix: str = "") -> dict[str, float | bool | str]:
    """Return every number, and the name of every model and term, of a JSON object by its path."""
    if isinstance(table, dict):
        pairs = [(f"{prefix}.{key}", value) for key, value in table.items() if key not in TIMES]
    elif isinstance(table, list):
        pairs = [(f"{prefix}[{index}]", value) for index, value in enumerate(table)]
    else:
        named = prefix.endswith((".model", ".term", ".at_bound"))
        return {prefix: table} if isinstance(table, (int, float)) or (named and table is not None) else {}
    return {key: value for name, inner in pairs for key, value in numbers(inner, name).items()}


if __name__ == "__main__":
    main()
