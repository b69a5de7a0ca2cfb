"""All rules of diagnosis are listed in one table."""

import ast
import re
from pathlib import Path

import pytest

from ehls_ros.diagnosis import rules

FOLDER = Path(rules.__file__).parent
MODULES = sorted(path.name for path in FOLDER.glob("*.py") if path.name != "rules.py")


def is_number(node: ast.expr | None) -> bool:
    """Return whether an expression consists of numbers alone."""
    numbers = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.Tuple, ast.operator, ast.unaryop, ast.expr_context)
    return node is not None and all(
        isinstance(part, numbers) and not (isinstance(part, ast.Constant) and not isinstance(part.value, int | float))
        for part in ast.walk(node)
    )


@pytest.mark.parametrize("module", MODULES)
def test_no_other_module_has_a_number_of_its_own(module):
    tree = ast.parse((FOLDER / module).read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            names = [ast.unparse(target) for target in (node.targets if isinstance(node, ast.Assign) else [node.target])]
            assert not is_number(node.value), f"{names} belongs into rules.py"


def test_every_number_of_the_table_is_declared():
    numbers = {name for name, value in vars(rules).items() if name.isupper() and isinstance(value, int | float)}
    assert {entry.name for entry in rules.table()} == numbers
    assert len(numbers) > 100


def test_every_rule_says_what_it_is():
    for name, value, rule in rules.table():
        assert rule.step in rules.STEPS, name
        assert rule.unit in {"1", "s", "K", "nat"}, name
        assert rule.meaning.endswith("."), name
        assert ". " not in rule.meaning, f"{name}: one sentence"
        assert rule.origin, name
        assert rules.__annotations__[name].__origin__ is type(value), name


def test_every_rule_is_used():
    texts = "".join(path.read_text(encoding="utf-8") for path in FOLDER.parent.rglob("*.py") if path.name != "rules.py")
    assert {entry.name for entry in rules.table()} == set(re.findall(r"rules\.([A-Z_]+)\b", texts))
