"""JSON Schemas of all kinds of YAML files, from the declarations used to check these files."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ehls_ros.control.programme.blocks import BLOCKS
from ehls_ros.control.programme.declaration import Limits as ProgrammeLimits
from ehls_ros.control.programme.declaration import Pacing
from ehls_ros.control.programme.declaration import Parameters as ProgrammeParameters
from ehls_ros.experiments.campaign.plan import Settings as CampaignSettings
from ehls_ros.experiments.campaign.variation import Distribution, Range, Values
from ehls_ros.experiments.spec import Settings
from ehls_ros.experiments.yaml_files import FAMILIES
from ehls_ros.families import Family
from ehls_ros.fmu.plant_map import INPUT_UNITS, OUTPUT_UNITS, Entry
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.hardware.calibration import Input, Output
from ehls_ros.json_schema import Schema, mapping_of, object_of, schema_of
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.data_sheet import DataSheet
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.parameters import Limits, Plant, Sensor
from ehls_ros.physics.plausibility import RANGES
from ehls_ros.physics.rig import EVERY_SENSED
from ehls_ros.physics.valve import VALVES
from ehls_ros.recording.columns import BASE, CYLINDER, ELEMENT_SIGNALS, ROTARY, TABLES, TIME, Column, Cylinder, Rotary
from ehls_ros.schema import notes
from ehls_ros.trajectory import READABLE

SIGNALS = FAMILIES["signal"]

POINTS_FILE = "CSV file with time_s and value; path relative to this file"

DIALECT = "http://json-schema.org/draft-07/schema#"
"""Dialect best supported by the YAML servers of editors."""


def _ref(name: str) -> Schema:
    return {"$ref": f"#/definitions/{name}"}


def schema_text(kind: str) -> str:
    """Return the schema of a kind of file.

    Args:
        kind: one of :data:`KINDS`.
    """
    made = KINDS[kind]()
    used: dict[str, Schema] = {}
    for name, make in reversed(list(SHARED.items())):
        if f'"{_ref(name)["$ref"]}"' in json.dumps([made, used]):
            used = {name: make(), **used}
    whole = {"$schema": DIALECT, "title": f"ehls {kind}", **({"definitions": used} if used else {}), **made}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def _rig() -> Schema:
    models: dict[str, Family[Any]] = {"friction": FRICTION_MODELS, "cylinder": CYLINDERS, "valve": VALVES}
    of_models = {section: _of_models(family) for section, family in models.items()}
    sections = {"plant": object_of(Plant, ()), **of_models, "limits": object_of(Limits, ())}
    for (section, key), (low, high) in RANGES.items():
        sections[section]["properties"][key] |= {"minimum": low, "maximum": high}
    return mapping_of(
        {
            **sections,
            "effects": _effects(),
            "sensors": _by_signal(Sensor, EVERY_SENSED),
            "standard_errors": {"type": "object", "additionalProperties": {"type": "number", "minimum": 0.0}},
        },
        ("friction",),
    )


def _of_models(family: Family[Any]) -> Schema:
    """Return the schema of a section that names a model, with the keys of all of them."""
    laws = family.usable().values()
    keys = {key: schema for law in laws for key, schema in object_of(law.Parameters)["properties"].items()}
    return mapping_of({"model": {"enum": list(family.names())}, **keys})


def _effects() -> Schema:
    return _several(_member_of(EFFECTS))


def _several(item: Schema) -> Schema:
    return {"anyOf": [{"type": "array", "items": item}, {"type": "null"}]}


def _experiment() -> Schema:
    single = {key: family for key, family in FAMILIES.items() if key not in ("signal", "companions")}
    named = {key: _ref("signal") if family is SIGNALS else _use(family) for key, family in single.items()}
    rig = {"anyOf": [{"type": "string", "description": "rig file; path relative to this file"}, _ref("rig"), {"type": "null"}]}
    more: dict[str, Schema] = {
        "rig": rig,
        "controller_rig": rig,
        "effects": _effects(),
        "known_effects": _several(_use(EFFECTS)),
        **named,
        "companions": _several(_use(FAMILIES["companions"])),
    }
    return object_of(Settings, ("rig", "reference", "controller"), **more)


def _campaign() -> Schema:
    varied = {"anyOf": [{"type": "array"}, *map(schema_of, (Values, Range, Distribution))]}
    paths: Schema = {"type": "object", "additionalProperties": varied}
    more: dict[str, Schema] = {
        "base": {
            "type": ["string", "object"],
            "description": "experiment: its content, or its path relative to this file",
        },
        "vary": {**paths, "description": "values by dotted path into the experiment"},
        "zip": {"type": "array", "items": paths, "description": "groups of paths whose values are taken together"},
    }
    return object_of(CampaignSettings, ("base",), **more)


def _bridge() -> Schema:
    parts = {"backend": _member_of(BACKENDS), "channels": _by_signal(Input, EVERY_SENSED), "command": schema_of(Output)}
    return mapping_of(parts, tuple(parts))


def _columns() -> Schema:
    column = _ref("column")
    tables: Schema = {
        "anyOf": [
            {"type": "array", "items": {"type": "string"}},
            {"type": "object", "additionalProperties": {"anyOf": [column, {"type": "null"}]}},
            {"type": "null"},
        ]
    }
    parts = {TABLES: tables, BASE: {"type": "string"}, CYLINDER: schema_of(Cylinder), ROTARY: schema_of(Rotary)}
    whole = mapping_of({**dict.fromkeys((TIME, *READABLE), column), **parts})
    return {**whole, "patternProperties": {f"^({'|'.join(ELEMENT_SIGNALS)})_[1-9][0-9]*$": column}}


def _plant_map() -> Schema:
    entry = {"anyOf": [{"type": "string", "description": "name of the FMU's variable"}, schema_of(Entry)]}
    return mapping_of(
        {
            "inputs": mapping_of(dict.fromkeys(INPUT_UNITS, entry)),
            "outputs": mapping_of(dict.fromkeys(OUTPUT_UNITS, entry)),
            "parameters": {"type": "object", "additionalProperties": {"type": "number"}},
        }
    )


def _answers() -> Schema:
    whole = object_of(DataSheet)
    for key, note in notes(DataSheet).items():
        own = whole["properties"][key]
        if note.unit:
            written = {"type": "string", "pattern": "^[0-9.eE+-]+ *[^0-9 ].*$", "description": "a number and its unit"}
            annotations = {word: own.pop(word) for word in ("description", "examples") if word in own}
            whole["properties"][key] = {**annotations, "anyOf": [*own.get("anyOf", [own]), written]}
    return whole


def _programme() -> Schema:
    entries: Schema = {"type": "array", "items": _ref("entry"), "minItems": 1}
    return object_of(ProgrammeParameters, ("blocks",), blocks=entries, **_shared_settings())


def _shared_settings() -> dict[str, Schema]:
    """Return the schemas of the settings that a programme has for all blocks and a block of its own."""
    return {"limits": schema_of(ProgrammeLimits), "pacing": schema_of(Pacing)}


def _entry() -> Schema:
    """Return the schema of a block or a repeat."""
    made = []
    for name, member in BLOCKS.usable().items():
        more: dict[str, Schema] = {"block": {"const": name}, "name": {"type": "string"}, **_shared_settings()}
        needed = object_of(member.Parameters)["required"]
        if "points" in member.Parameters._fields:
            more["file"] = {"type": "string", "description": POINTS_FILE}
            needed = [key for key in needed if key != "points"]
        if "reference" in member.Parameters._fields:
            more["reference"] = _ref("signal")
        made.append(object_of(member.Parameters, ("block", *needed), **more))
    blocks: Schema = {"type": "array", "items": _ref("entry"), "minItems": 1}
    repeat = mapping_of({"repeat": {"type": "integer", "minimum": 1}, "blocks": blocks}, ("repeat", "blocks"))
    return {"anyOf": [repeat, *made]}


def _by_signal(kind: type, signals: Sequence[str]) -> Schema:
    one = {"anyOf": [schema_of(kind), {"type": "null"}]}
    return {"anyOf": [mapping_of(dict.fromkeys(signals, one)), {"type": "null"}]}


def _member_of(family: Family[Any]) -> Schema:
    """Return the schema of a mapping that names a member of a family and has its parameters."""
    made = []
    for name, member in family.usable().items():
        more: dict[str, Schema] = {"name": {"const": name}}
        if "points" in member.Parameters._fields:
            more["file"] = {"type": "string", "description": POINTS_FILE}
        if "blocks" in member.Parameters._fields:
            more["file"] = {"type": "string", "description": "programme file; path relative to this file"}
        if family is FAMILIES["disturbance"]:
            more["signal"] = _ref("signal")
        needed = [
            key for key in object_of(member.Parameters)["required"] if "file" not in more or key not in {"points", "blocks"}
        ]
        made.append(object_of(member.Parameters, ("name", *needed), **more))
    return {"anyOf": made}


def _use(family: Family[Any]) -> Schema:
    return {"anyOf": [{"enum": list(family.names())}, *_member_of(family)["anyOf"]]}


SHARED: Mapping[str, Callable[[], Schema]] = {
    "rig": _rig,
    "signal": lambda: _use(SIGNALS),
    "column": lambda: schema_of(Column),
    "entry": _entry,
}
"""Definitions used several times in a schema; each may refer to those before it."""

KINDS: Mapping[str, Callable[[], Schema]] = {
    "rig": _rig,
    "experiment": _experiment,
    "campaign": _campaign,
    "programme": _programme,
    "bridge": _bridge,
    "columns": _columns,
    "answers": _answers,
    "plant_map": _plant_map,
}
"""Schema of each kind of file."""
