"""Sums of columns, such as the deflection "motor/20 - joint": parsed into a factor for each column, never evaluated."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, NoReturn

from hil.errors import WrongUse

_LONGEST = 300  # characters
_GRAMMAR = (
    "write names of columns and numbers with + - * /, such as 'motor/20 - joint'; a unit behind the name, joint[deg]; "
    "and quotation marks around a name with spaces"
)


class Term(NamedTuple):
    """A column in a sum, its unit if the expression states one, and the factor in front of it."""

    column: str
    unit: str | None
    factor: float


class _Sum(NamedTuple):
    """A number, or else a sum of columns."""

    number: float
    terms: tuple[Term, ...] = ()

    def times(self, factor: float) -> _Sum:
        return _Sum(self.number * factor, tuple(one._replace(factor=one.factor * factor) for one in self.terms))


def terms(text: str, place: Callable[[str], int], has: Callable[[str], bool]) -> list[Term]:
    """Return the columns of a sum with their factors; a text that is the name of a column is that column.

    place, has: find a column of the table by name; `place` raises WrongUse. Raises WrongUse for a column that is not
    there, a division by zero or by a column, a number without a unit in the sum, and for anything but + - * /.
    """
    if has(text):
        return [Term(text, None, 1.0)]
    if len(text) > _LONGEST:
        raise WrongUse(f"{text[:40]!r}... has {len(text)} characters, and may have {_LONGEST}: {_GRAMMAR}")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        return _no_sum(text, place)
    found = _Parser(text.strip(), place, has).sum_of(tree.body)
    if not found.terms or not all(math.isfinite(one.factor) for one in found.terms):
        raise WrongUse(f"{text!r} is not a sum of columns with finite factors: {_GRAMMAR}")
    return list(found.terms)


def _no_sum(text: str, place: Callable[[str], int]) -> NoReturn:
    try:
        place(text)
    except WrongUse as missing:
        raise WrongUse(f"{missing}. For a sum of columns {_GRAMMAR}") from None
    raise AssertionError(text)  # a column of this name would have been found


@dataclass(frozen=True, slots=True)
class _Parser:
    """The text of an expression, and the columns that it may name."""

    text: str
    place: Callable[[str], int]
    has: Callable[[str], bool]

    def sum_of(self, node: ast.expr) -> _Sum:
        """Return the sum that a node of the syntax tree means. Raises WrongUse."""
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return _Sum(float(number))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign):
                return self.sum_of(node.operand).times(-1.0 if isinstance(sign, ast.USub) else 1.0)
            case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div()):
                return self._joined(node)
            case ast.Name() | ast.Attribute() | ast.Subscript() | ast.Call() | ast.Constant(value=str()):
                return _Sum(0.0, (self._column(node),))
        raise WrongUse(f"{self.text!r}: {self._written(node)!r} cannot stand in a sum of columns: {_GRAMMAR}")

    def _joined(self, node: ast.BinOp) -> _Sum:
        left, right = self.sum_of(node.left), self.sum_of(node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            right = right.times(-1.0 if isinstance(node.op, ast.Sub) else 1.0)
            if bool(left.terms) == bool(right.terms):
                return _Sum(left.number + right.number, left.terms + right.terms)
            self._refuse(node, "adds a number without a unit to a column")
        if isinstance(node.op, ast.Div):
            if right.terms or right.number == 0.0:
                self._refuse(node, "divides by a column" if right.terms else "divides by zero")
            return left.times(1.0 / right.number)
        if left.terms and right.terms:
            self._refuse(node, "multiplies two columns")
        return left.times(right.number) if left.terms or not right.terms else right.times(left.number)

    def _column(self, node: ast.expr) -> Term:
        name = node.value if isinstance(node, ast.Constant) else self._written(node)
        if not self.has(str(name)) and isinstance(node, ast.Subscript):  # joint[deg]
            inner = node.value.value if isinstance(node.value, ast.Constant) else self._written(node.value)
            if self.has(str(inner)):
                return Term(str(inner), self._written(node.slice), 1.0)
        self.place(str(name))
        return Term(str(name), None, 1.0)

    def _written(self, node: ast.expr) -> str:
        return ast.get_source_segment(self.text, node) or ""

    def _refuse(self, node: ast.expr, what: str) -> None:
        raise WrongUse(f"{self.text!r} {what} ({self._written(node)}): {_GRAMMAR}")
