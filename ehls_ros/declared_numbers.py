"""Numbers that a module declares at its top level, with the docstring of each."""

import ast
import inspect
from itertools import pairwise
from types import ModuleType
from typing import NamedTuple


class DeclaredNumber(NamedTuple):
    """A number declared at the top level of a module.

    Attributes:
        module: name of the module.
        name: name of the number.
        value: its value.
        meaning: first paragraph of its docstring, with the unit in brackets at its end; empty without a docstring.
        origin: the docstring's ``Origin``: a benchmark run with figures, or a reason; empty for a number chosen by judgement.
        derived: the expression that gives it from others; empty for one that is written as a plain number.
    """

    module: str
    name: str
    value: float
    meaning: str
    origin: str
    derived: str

    @property
    def chosen(self) -> bool:
        """Whether it was chosen by judgement."""
        return not (self.origin or self.derived)


def declared_numbers(module: ModuleType) -> list[DeclaredNumber]:
    """Return the numbers declared at the top level of a module, in order."""
    found = []
    for statement, after in pairwise([*ast.parse(inspect.getsource(module)).body, ast.Pass()]):
        match statement:
            case ast.Assign(targets=[ast.Name(id=name)], value=expression):
                pass
            case _:
                continue
        value = getattr(module, name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        text = ""
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
            text = inspect.cleandoc(after.value.value)
        meaning, *more = (" ".join(part.split()) for part in text.split("\n\n"))
        origin = next((part.removeprefix("Origin: ") for part in more if part.startswith("Origin: ")), "")
        names = any(isinstance(part, ast.Name) for part in ast.walk(expression))
        found.append(DeclaredNumber(module.__name__, name, value, meaning, origin, ast.unparse(expression) if names else ""))
    return found
