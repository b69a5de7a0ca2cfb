"""All numbers of diagnosis are described where they are declared, and those of judgement are in one table."""

import pkgutil
import re
from importlib import import_module
from pathlib import Path

import pytest

from ehls_ros import diagnosis
from ehls_ros.declared_numbers import DeclaredNumber, declared_numbers
from ehls_ros.diagnosis import rules

FOLDER = Path(rules.__file__).parent
MODULES = [module.name for module in pkgutil.walk_packages(diagnosis.__path__, f"{diagnosis.__name__}.")]
NUMBERS = [number for module in MODULES for number in declared_numbers(import_module(module))]


@pytest.mark.parametrize("number", NUMBERS, ids=[f"{n.module.rpartition('.')[2]}.{n.name}" for n in NUMBERS])
def test_every_number_says_what_it_is(number: DeclaredNumber):
    assert number.meaning.endswith(".")
    assert ". " not in number.meaning, "one sentence"
    assert set(re.findall(r"\[([^]]*)\]\.$", number.meaning)) <= {"s", "K", "nat", "rad/s"}


def test_every_number_has_one_place():
    names = [number.name for number in NUMBERS]
    assert len(names) == len(set(names))


def test_every_rule_is_used():
    texts = "".join(path.read_text(encoding="utf-8") for path in FOLDER.parent.rglob("*.py") if path.name != "rules.py")
    derived = " ".join(number.derived for number in declared_numbers(rules))
    used = {*re.findall(r"rules\.([A-Z_]+)\b", texts), *re.findall(r"\b[A-Z_]+\b", derived)}
    assert {number.name for number in declared_numbers(rules)} == used


def test_derived_numbers_name_their_source():
    by_name = {number.name: number for number in NUMBERS}
    assert by_name["GUIDE"].derived
    assert not by_name["GUIDE"].chosen
    assert by_name["TOLERANCE"].chosen


def test_rules_are_few():
    assert len(declared_numbers(rules)) <= 120
