"""Sums of columns, such as the deflection "motor/20 - joint": parsed into a factor for each column, never evaluated."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

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


Sum = dict[tuple[str, str | None], float]  # the factor of each column, by name and unit; a number has the name ""
_NUMBER = ("", None)


def terms(text: str, place: Callable[[str], int], has: Callable[[str], bool], signed: Sequence[str] = ()) -> list[Term]:
    """Return the columns of a sum with their factors; a text that is the name of a column is that column.

    signed: names of columns with signs in them, which are names in a sum too. place, has: functions of a column's name:
    its index, and whether the table has it. Raises WrongUse for a column that is not there, a division by zero or by a
    column, a number without a unit in the sum, and for anything but + - * /.
    """
    if has(text):
        return [Term(text, None, 1.0)]
    if len(text) > _LONGEST:
        raise WrongUse(f"{text[:40]!r}... has {len(text)} characters, more than {_LONGEST}: {_GRAMMAR}")
    for name in sorted(signed, key=len, reverse=True):  # x-axis
        text = re.sub(rf"(?<![\w'\"\[.]){re.escape(name)}(?![\w'\"(.])", lambda found: repr(found[0]), text)
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        try:
            place(text)
        except WrongUse as missing:
            raise WrongUse(f"{missing}. For a sum of columns {_GRAMMAR}") from None
    found = _Parser(text.strip(), place, has).sum_of(tree.body)
    if _NUMBER in found or not all(map(math.isfinite, found.values())):
        raise WrongUse(f"{text!r} is not a sum of columns with finite factors: {_GRAMMAR}")
    return [Term(*key, factor) for key, factor in found.items()]


def quoted_name(name: str) -> str:
    """Return the name of a column as it is written in a sum."""
    return name if name.isidentifier() else repr(name)


@dataclass(frozen=True, slots=True)
class _Parser:
    """The text of an expression, and the columns that it may name."""

    text: str
    place: Callable[[str], int]
    has: Callable[[str], bool]

    def sum_of(self, node: ast.expr) -> Sum:
        """Return the sum that a node of the syntax tree means. Raises WrongUse."""
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return {_NUMBER: float(number)}
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign):
                return _times(self.sum_of(node.operand), -1.0 if isinstance(sign, ast.USub) else 1.0)
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                left, right = self.sum_of(node.left), self.sum_of(node.right)
                if (_NUMBER in left) is not (_NUMBER in right):
                    raise self._wrong(node, "adds a number without a unit to a column")
                right = _times(right, -1.0 if isinstance(node.op, ast.Sub) else 1.0)
                return {key: left.get(key, 0.0) + right.get(key, 0.0) for key in left | right}
            case ast.BinOp(op=ast.Mult() | ast.Div()):
                return self._product(node, self.sum_of(node.left), self.sum_of(node.right))
            case ast.Name() | ast.Attribute() | ast.Subscript() | ast.Call() | ast.Constant(value=str()):
                return {self._column(node): 1.0}
        raise WrongUse(f"{self.text!r}: {self._written(node)!r} cannot stand in a sum of columns: {_GRAMMAR}")

    def _product(self, node: ast.BinOp, left: Sum, right: Sum) -> Sum:
        if isinstance(node.op, ast.Div):
            if not right.get(_NUMBER):
                raise self._wrong(node, "divides by zero" if _NUMBER in right else "divides by a column")
            return _times(left, 1.0 / right[_NUMBER])
        if _NUMBER not in left and _NUMBER not in right:
            raise self._wrong(node, "multiplies two columns")
        return _times(left, right[_NUMBER]) if _NUMBER in right else _times(right, left[_NUMBER])

    def _column(self, node: ast.expr) -> tuple[str, str | None]:
        name = self._written(node)
        if not self.has(name) and isinstance(node, ast.Subscript) and self.has(inner := self._written(node.value)):
            return inner, self._written(node.slice)  # joint[deg]
        self.place(name)
        return name, None

    def _written(self, node: ast.expr) -> str:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return node.value
        return ast.get_source_segment(self.text, node) or ""

    def _wrong(self, node: ast.expr, what: str) -> WrongUse:
        return WrongUse(f"{self.text!r} {what} ({self._written(node)}): {_GRAMMAR}")


def _times(one: Sum, factor: float) -> Sum:
    return {key: own * factor for key, own in one.items()}
