"""What stands in the modules of the packages under test: those of a checkout, or where they are installed."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("hil", "ga", "drivers", "sim_backend")


@dataclass
class Module:
    """Facts of one module.

    functions: lines of each, by its first line and name. codes: of its diagnostics. named: numbers in assignments at
    the top level; decides: those that are no plain ones; unnamed: in functions, but no plain ones, no index, no
    exponent.
    """

    lines: int
    functions: dict[str, int] = field(default_factory=dict)
    codes: set[str] = field(default_factory=set)
    named: int = 0
    decides: list[object] = field(default_factory=list)
    unnamed: int = 0


@cache
def root() -> Path:
    """The folder that holds the packages."""
    spec = find_spec("hil")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parents[1]


@cache
def texts() -> dict[str, str]:
    """The text of each module by its path from `root`."""
    paths = [path for package in PACKAGES for path in sorted((root() / package).rglob("*.py"))]
    return {path.relative_to(root()).as_posix(): path.read_text(encoding="utf-8") for path in paths}


@cache
def modules() -> dict[str, Module]:
    """The modules by their path from `root`; it takes 2 s."""
    return {path: _read(text) for path, text in texts().items()}


def _read(text: str) -> Module:
    tree, module = ast.parse(text), Module(text.count("\n"))
    clear: set[ast.AST] = set()
    in_functions: set[ast.Constant] = set()
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                module.functions[f"{node.lineno} {node.name}"] = (node.end_lineno or 0) - node.lineno + 1
                in_functions.update(number for statement in node.body for number in _numbers(statement))
            case ast.Subscript(slice=part) | ast.BinOp(op=ast.Pow(), right=part):
                clear.update(_numbers(part))
            case ast.Call(func=ast.Name(id="Diagnostic"), args=[ast.Constant(value=code), *_]):
                module.codes.add(str(code))
    assigned = [s.value for s in tree.body if isinstance(s, ast.Assign | ast.AnnAssign) and s.value is not None]
    named = [number.value for value in assigned for number in _numbers(value)]
    module.named, module.decides = len(named), [value for value in named if not _is_plain(value)]
    module.unnamed = sum(not _is_plain(number.value) for number in in_functions - clear)
    return module


def _numbers(node: ast.AST) -> list[ast.Constant]:
    return [n for n in ast.walk(node) if isinstance(n, ast.Constant) and type(n.value) in {int, float}]


def _is_plain(value: object) -> bool:
    """Whether a number needs no name: a small whole one, a half, a power of ten."""
    return isinstance(value, int | float) and (
        value in {-1, 0, 1, 2, 3, 4, 0.5} or f"{abs(value):e}".startswith("1.000000e")
    )
