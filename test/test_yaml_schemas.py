"""The editors' schemas of the YAML files agree with the loaders."""

import copy
import re
from pathlib import Path

import pytest

from ehls_ros.cli.verbs.new_rig import template
from ehls_ros.experiments.yaml_schemas import KINDS, schema_text
from ehls_ros.recording.yaml_text import parse_yaml, read_yaml

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")

ROOT = Path(__file__).parent.parent
SCHEMAS = ROOT / "config" / "schemas"
LINE = re.compile(r"# yaml-language-server: \$schema=(\S+)\n")
OTHERS = {"diagnostic_aggregator.yaml"}
"""YAML of other programs."""

FILES = [p for p in (*ROOT.glob("config/**/*.yaml"), *ROOT.glob("examples/**/*.yaml")) if p.name not in OTHERS]


def checker(kind):
    return jsonschema.Draft7Validator(parse_yaml((SCHEMAS / f"{kind}.json").read_text(encoding="utf-8"), kind, "schema"))


@pytest.mark.parametrize("kind", KINDS)
def test_the_committed_schema_is_what_the_declarations_say(kind):
    made = schema_text(kind)
    jsonschema.Draft7Validator.check_schema(parse_yaml(made, kind, "schema"))
    assert (SCHEMAS / f"{kind}.json").read_text(encoding="utf-8") == made, f"ehls schema {kind} > config/schemas/{kind}.json"


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_file_names_its_schema_and_keeps_to_it(path):
    line = LINE.match(path.read_text(encoding="utf-8"))
    assert line, "a first line for editors"
    schema = (path.parent / line[1]).resolve()
    assert schema.parent == SCHEMAS
    errors = [f"{list(e.path)}: {e.message}" for e in checker(schema.stem).iter_errors(read_yaml(path, "file"))]
    assert not errors


WRONG_RIGS = {
    "bar for Pa": ("plant", "supply_pressure", 70.0),
    "MPa for Pa": ("plant", "bulk_modulus", 690.0),
    "mm² for m²": ("plant", "piston_area", 2600.0),
    "a typing error": ("plant", "suply_pressure", 7e6),
    "a negative mass": ("plant", "moving_mass", -70.0),
    "a text for a number": ("plant", "oil_density", "840"),
    "a model that is not": ("friction", "model", "stribek"),
    "one end of two": ("limits", "position", [0.3]),
    "a sensor that is not": ("sensors", "pressure", {"noise_std": 1.0}),
    "a section that is not": ("plants", "arm_length", 0.5),
}


@pytest.mark.parametrize("wrong", WRONG_RIGS)
def test_wrong_rig_files_are_marked(wrong):
    rig = read_yaml(ROOT / "config" / "rig_paper.yaml", "rig file")
    section, key, value = WRONG_RIGS[wrong]
    content = copy.deepcopy(rig) | {section: {**rig.get(section, {}), key: value}}
    assert not checker("rig").is_valid(content)


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        ("rig", "{friction: {model: gms}, effects: [{name: valve_dead_band}]}"),
        ("rig", "{friction: {model: gms}, effects: [{name: valve_dead_zone, positive: -1.0}]}"),
        ("experiment", "{rig: a.yaml, reference: {name: sine, amplitud: 1.0, frequency: 1.0}, controller: pid}"),
        ("experiment", "{rig: a.yaml, reference: constant, controller: pi}"),
        ("campaign", "{base: a.yaml, vary: {duration: {start: 1.0, end: 2.0, points: 3}}}"),
        ("bridge", "{backend: {name: udp}, channels: {}}"),
        ("columns", "{position_mm: {name: x}}"),
        ("columns", "{position_m: {name: x, units: mm}}"),
        ("answers", "{bore: 63}"),
    ],
)
def test_other_wrong_files_are_marked(kind, content):
    assert not checker(kind).is_valid(parse_yaml(content, kind, "file"))


def test_answers_may_have_units():
    text = template()
    for name, figure in {"bore": "63 mm", "rod": 36, "rods": "two", "stroke": 200, "supply_pressure": "210 bar"}.items():
        text = text.replace(f"\n{name}: ", f"\n{name}: {figure} ")
    text = text.replace("\nrated_flow: ", "\nrated_flow: 38 l/min ").replace("\nrated_drop: ", "\nrated_drop: 70 ")
    assert checker("answers").is_valid(parse_yaml(text, "answers", "file"))
