"""The generated reference contains everything the code declares."""

import importlib
from collections import defaultdict
from collections.abc import Iterator
from types import ModuleType

import pytest
from docs_snippets import ROOT

import ehls_ros
from ehls_ros.cli.verbs import VERBS
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.declared_numbers import declared_numbers
from ehls_ros.diagnosis import rules
from ehls_ros.nodes import node_names
from ehls_ros.schema import declarations
from ehls_ros.trajectory import SIGNALS


@pytest.fixture(scope="module")
def reference() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "docs" / "_ext"))
        yield importlib.import_module("reference_pages")


def test_every_member_of_every_family_has_its_parameters(reference: ModuleType) -> None:
    page = reference.parameters_page().replace("\\|", "|")
    sections = defaultdict[str, str](str)
    for text in page.split("\n### ")[1:]:
        # Members of two families may have the same name.
        sections[text.partition("\n")[0]] += text
    for family in reference.FAMILIES.values():
        for name in family.names():
            for declared in declarations(family.load(name).Parameters):
                assert f"| `{declared.name}` | " in sections[name], f"{name}: {declared.name}"
                assert declared.description in sections[name]


def test_every_verb_has_its_help(reference: ModuleType) -> None:
    page = reference.commands_page()
    for name in VERBS.names():
        assert f"\n## ehls {name.replace('_', '-')}\n" in page
    assert "--in-process" in page
    assert "\x1b" not in page


def test_every_node_message_and_signal_is_there(reference: ModuleType) -> None:
    nodes, messages, signals = reference.nodes_page(), reference.messages_page(), reference.signals_page()
    for name in node_names():
        assert f"\n## {name}\n" in nodes
    for path in (ROOT / "ehls_msgs" / "msg").glob("*.msg"):
        assert f"\n## {path.stem}\n" in messages
    assert "| `load_pressure` | `float64` | load pressure pL = p1 - p2 [Pa] |" in messages
    for name in SIGNALS:
        assert f"| `{name}` |" in signals


def test_a_table_shows_required_parameters_and_ranges(reference: ModuleType) -> None:
    page = reference.parameters_page()
    assert "| `supply_pressure` | required | Pa |" in page
    assert "| `k` | 12 × pressure | MPa/s | 0.1 … 1000 |" in page
    assert "| `phi1` | 0.001 × 1 / force / pressure / compression |" in page
    assert "| `spacing` | linear | – | linear, log |" in page


def test_services_are_those_of_the_plant_node(reference: ModuleType) -> None:
    names = ("emergency_stop", "acknowledge_stop", "unload", "reset_trips", "enable", "switch_controller")
    assert {name for name, _, _ in reference.plant_services()} == {f"`/ehls/{name}`" for name in names}


def test_every_public_name_is_on_the_page_of_python(reference: ModuleType) -> None:
    assert sorted(name for names in reference.API.values() for name in names) == ehls_ros.__all__


def test_every_rule_of_diagnosis_has_its_row(reference: ModuleType) -> None:
    page = reference.rules_page()
    for number in declared_numbers(rules):
        assert f"| `{number.name}` | {number.value:g} | {number.meaning} | " in page
    assert "## `fit.py`\n" in page


def test_the_launch_file_offers_every_controller(reference: ModuleType) -> None:
    default, _, choices = reference.launch_arguments()["controller"]
    assert tuple(choices) == ("", *CONTROLLERS.names())
    assert default == ""
