"""Signals computed from several columns, such as ``pA - pB``: arithmetic only."""

import ast
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAX_LENGTH = 300
"""Longest expression [characters]."""

MAX_NUMBER = 1e300
"""Largest number in an expression."""

NAME = re.compile(r"`([^`]+)`|(?<![\w.])([^\W\d]\w*)")
"""A column: any name between backticks, or a word."""

BINARY: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}

UNARY: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {ast.UAdd: operator.pos, ast.USub: operator.neg}


class Expression(NamedTuple):
    """A checked expression.

    Attributes:
        names: source columns, in order of appearance.
        tree: syntax tree, with the columns by number: ``_0``, ``_1`` and so on.
    """

    names: tuple[str, ...]
    tree: ast.expr

    def of(self, columns: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Evaluate the expression on columns by name, each of shape (n,)."""
        values = [np.asarray(columns[name], dtype=np.float64) for name in self.names]
        with np.errstate(all="ignore"):  # non-finite values are rejected later, with their place
            out: NDArray[np.float64] = _value(self.tree, values)
        return out


def expression(text: str) -> Expression:
    """Parse an expression.

    Raises:
        ValueError: it is too long, uses no column, or is more than arithmetic; the message says which.
    """
    if len(text) > MAX_LENGTH:
        raise ValueError(f"it has more than {MAX_LENGTH} characters")
    names: dict[str, int] = {}

    def numbered(match: re.Match[str]) -> str:
        return f"_{names.setdefault(match[1] or match[2], len(names))}"

    try:
        tree = ast.parse(NAME.sub(numbered, text).strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError("it is not arithmetic") from None
    _check(tree, len(names))
    if not names:
        raise ValueError("it uses no column")
    return Expression(tuple(names), tree)


def _check(node: ast.expr, names: int) -> None:
    match node:
        case ast.BinOp() if type(node.op) in BINARY:
            _check(node.left, names)
            _check(node.right, names)
        case ast.UnaryOp() if type(node.op) in UNARY:
            _check(node.operand, names)
        case ast.Name() if node.id in {f"_{number}" for number in range(names)}:
            pass
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool) and abs(value) < MAX_NUMBER:
            pass
        case _:
            raise ValueError("it is more than columns, numbers, + - * / ** and parentheses")


def _value(node: ast.expr, values: list[NDArray[np.float64]]) -> Any:
    match node:
        case ast.BinOp():
            return BINARY[type(node.op)](_value(node.left, values), _value(node.right, values))
        case ast.UnaryOp():
            return UNARY[type(node.op)](_value(node.operand, values))
        case ast.Name():
            return values[int(node.id[1:])]
        case ast.Constant(value=int() | float() as value):
            return np.float64(value)  # a large power of Python integers would take forever
        case _:
            raise AssertionError(node)
