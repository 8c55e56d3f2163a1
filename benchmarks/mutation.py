"""Change one operator of the source at a time and see whether a test notices: python benchmarks/mutation.py ...

    draw --seed 41 --count 100 -o mutants.json     draw mutants at random from the source of this checkout
    run mutants.json --coverage FILE -o rows.csv   run the tests that cover each mutant's line, and note which fail

`run` changes the source files of the checkout in which it is started, one after the other, and restores each: start it
in a clone. The coverage file holds which test runs which line (`pytest --cov --cov-context=test`, and `coverage
combine`). Coverage does not see compiled functions: for a line in one, the tests of its package are run. A mutant is
found again in a changed source by the name of its function and the text of its line; a row says `gone` where that line
is no longer there.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import csv
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import coverage

WHERE = ("ga", "hil/identification", "hil/signals", "hil/acquisition", "hil/guardian", "drivers/gate.py")
SWAPS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: (" is ", " is not "),
    ast.IsNot: (" is not ", " is "),
    ast.In: (" in ", " not in "),
    ast.NotIn: (" not in ", " in "),
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.And: (" and ", " or "),
    ast.Or: (" or ", " and "),
    ast.Not: ("not ", ""),
}
LIMIT = 900  # s of wall time after which the tests of a mutant count as hanging, which is a failure too


@dataclass(frozen=True)
class Mutant:
    """One changed place: in the `nth` line of that text within a function, columns start to end become `new`."""

    path: str
    function: str
    line: str
    nth: int
    start: int
    end: int
    new: str


def functions(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Give each outermost function and method with its dotted name."""

    def below(node: ast.AST, name: str) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{name}{child.name}", child
            elif isinstance(child, ast.ClassDef):
                yield from below(child, f"{name}{child.name}.")

    yield from below(tree, "")


def places(function: ast.AST, lines: list[str]) -> Iterator[tuple[int, int, int, str]]:
    """Give line number, first and last column, and new text of every change that a function offers."""
    for node in ast.walk(function):
        if isinstance(node, ast.Constant) and type(node.value) in {int, float, bool}:
            if node.lineno == node.end_lineno and node.end_col_offset is not None:
                new = repr(not node.value) if isinstance(node.value, bool) else repr(node.value + 1)
                yield node.lineno, node.col_offset, node.end_col_offset, new
            continue
        for operator, left, right in operators(node):
            old, new = SWAPS[type(operator)]
            line = lines[left.end_lineno - 1] if left is not None else lines[right.lineno - 1]
            first = left.end_col_offset if left is not None else node.col_offset  # type: ignore[attr-defined]
            last = right.col_offset if left is None or right.lineno == left.end_lineno else len(line)
            at = line.find(old, first, last)
            if at >= 0:
                yield left.end_lineno if left is not None else right.lineno, at, at + len(old), new


def operators(node: ast.AST) -> Iterator[tuple[ast.AST, ast.expr | None, ast.expr]]:
    """Give each operator of a node that can be swapped, with the expressions on its left and right."""
    if isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        every: list[tuple[ast.AST, ast.expr | None, ast.expr]] = [
            (operator, sides[n], sides[n + 1]) for n, operator in enumerate(node.ops)
        ]
    elif isinstance(node, ast.BoolOp):
        every = [(node.op, node.values[0], node.values[1])]
    elif isinstance(node, ast.BinOp):
        every = [(node.op, node.left, node.right)]
    elif isinstance(node, ast.UnaryOp):
        every = [(node.op, None, node.operand)]
    else:
        every = []
    yield from (one for one in every if type(one[0]) in SWAPS)


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Give every mutant of a source file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    for name, function in functions(ast.parse("\n".join(lines))):
        body = lines[function.lineno - 1 : function.end_lineno]
        for number, start, end, new in sorted(set(places(ast.Module(function.body, []), lines))):
            text = lines[number - 1]
            nth = body[: number - function.lineno].count(text)
            yield Mutant(path.as_posix(), name, text, nth, start, end, new)


def draw(options: argparse.Namespace) -> None:
    """Write mutants drawn at random, each place with the same chance."""
    folders = [Path(where) for where in WHERE]
    files = sorted(file for one in folders for file in ([one] if one.suffix else one.rglob("*.py")))
    every = [mutant for file in files for mutant in mutants_of(file)]
    drawn = random.Random(options.seed).sample(every, options.count)  # noqa: S311 - no secret
    options.output.write_text(json.dumps([asdict(mutant) for mutant in drawn], indent=1))
    print(f"{len(drawn)} of {len(every)} mutants in {len(files)} files, seed {options.seed}")


def found(mutant: Mutant) -> tuple[str, int, bool] | None:
    """Return the changed source, the line's number and whether its function is compiled; None where it is gone."""
    path = Path(mutant.path)
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    for name, function in functions(ast.parse("\n".join(lines))):
        if name != mutant.function:
            continue
        places_ = [n for n in range(function.lineno - 1, function.end_lineno or 0) if lines[n] == mutant.line]
        if len(places_) <= mutant.nth:
            return None
        at = places_[mutant.nth]
        lines[at] = mutant.line[: mutant.start] + mutant.new + mutant.line[mutant.end :]
        machine = any("compiled" in ast.unparse(decorator) for decorator in function.decorator_list)
        return "\n".join(lines) + "\n", at + 1, machine
    return None


def covering(data: coverage.CoverageData, path: str, line: int, *, machine: bool) -> list[str]:
    """Return the tests that run a line, and all of its package for a line of a compiled function."""
    measured = [name for name in data.measured_files() if name.endswith("/" + path)]
    tests = {
        context.rpartition("|")[0]
        for name in measured
        for context in data.contexts_by_lineno(name).get(line, [])
        if context
    }
    if machine:
        tests |= {f"tests/{Path(path).parts[0]}"}
    return sorted(tests)


def run(options: argparse.Namespace) -> None:
    """Run the covering tests of each mutant and write a row for each."""
    data = coverage.CoverageData(str(options.coverage))
    data.read()
    stream = options.output.open("a", newline="", buffering=1)
    rows = csv.writer(stream, lineterminator="\n")
    for number, entry in enumerate(json.loads(options.mutants.read_text())):
        if number not in range(options.first, options.last):
            continue
        mutant = Mutant(**entry)
        change = found(mutant)
        outcome, failed, count = "gone", "", 0
        if change is not None:
            source, line, machine = change
            tests = covering(data, mutant.path, line, machine=machine)
            count = len(tests)
            outcome, failed = judged(Path(mutant.path), source, tests, options.only) if tests else ("not covered", "")
        row = [number, mutant.path, mutant.function, mutant.line.strip(), mutant.new.strip(), count, outcome, failed]
        rows.writerow(row)
        print(*row, sep=" | ", flush=True)


def judged(path: Path, source: str, tests: list[str], only: str) -> tuple[str, str]:
    """Return whether a test fails with that source, and the first that does."""
    before = path.read_text(encoding="utf-8")
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as listed:
        listed.write("\n".join(tests))
        listed.flush()
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", only, f"@{listed.name}"]
        try:
            path.write_text(source, encoding="utf-8")
            child = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
            )
            try:
                printed, _ = child.communicate(timeout=LIMIT)
            except subprocess.TimeoutExpired:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(child.pid, signal.SIGKILL)
                child.communicate()
                return "killed", "hangs"
        finally:
            path.write_text(before, encoding="utf-8")
    if child.returncode == 0:
        return "survived", ""
    if child.returncode < 0:
        return "killed", f"ended by signal {-child.returncode}"
    reasons = [line for line in printed.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return ("killed", reasons[0][:160]) if reasons else ("not run", printed[-200:].replace("\n", " "))


def main() -> None:
    """Draw or run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    drawing = verbs.add_parser("draw")
    drawing.add_argument("--seed", type=int, default=41)
    drawing.add_argument("--count", type=int, default=100)
    drawing.add_argument("-o", dest="output", type=Path, required=True)
    drawing.set_defaults(do=draw)
    running = verbs.add_parser("run")
    running.add_argument("mutants", type=Path)
    running.add_argument("--coverage", type=Path, required=True)
    running.add_argument("--only", default="study or not study", help="an expression of markers")
    running.add_argument("--first", type=int, default=0)
    running.add_argument("--last", type=int, default=10**9)
    running.add_argument("-o", dest="output", type=Path, required=True)
    running.set_defaults(do=run)
    options = parser.parse_args()
    options.do(options)


if __name__ == "__main__":
    main()
