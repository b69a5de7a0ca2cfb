"""Rig files and experiment specs as text, with the units beside the values as in the package's files."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.references import REFERENCES
from ehls_ros.experiments.spec import Settings
from ehls_ros.families import Family
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.parameters import Limits, Plant, Sensor
from ehls_ros.physics.valve import VALVES
from ehls_ros.schema import notes

Remarks = Mapping[str, Any]
"""Remark on each key's value, or the remarks on the entries of a nested mapping."""

FAMILIES: Mapping[str, Family[Any]] = {
    "reference": REFERENCES,
    "signal": REFERENCES,
    "disturbance": DISTURBANCES,
    "controller": CONTROLLERS,
    "compensation": OBSERVERS,
    "companions": COMPANIONS,
}
"""Sections of a spec that name a member of a family."""

COLUMN = 38
"""Column where remarks begin, unless the value is longer."""


def rig_text(rig: Mapping[str, Any], more: Mapping[str, Mapping[str, str]] | None = None) -> str:
    """Return a rig file.

    Args:
        rig: its content, as :func:`ehls_ros.physics.rig.rig_to_mapping` returns it.
        more: text after the unit of a value, by section and key.
    """
    return "\n".join(_lines(_plain(rig), _of_rig(rig, more or {}))) + "\n"


def spec_text(spec: Mapping[str, Any]) -> str:
    """Return an experiment's file.

    Args:
        spec: its content; rigs by file name or as mappings.
    """
    remarks = dict[str, Any](_units(Settings))
    for key, value in spec.items():
        if key in FAMILIES:
            several = isinstance(value, list)
            remarks[key] = [_of_use(FAMILIES[key], use) for use in value] if several else _of_use(FAMILIES[key], value)
        elif key in ("rig", "controller_rig") and isinstance(value, Mapping):
            remarks[key] = _of_rig(value, {})
    return "\n".join(_lines(_plain(spec), remarks)) + "\n"


def commented(values: Mapping[str, Any], remarks: Remarks) -> str:
    """Return a mapping as YAML with remarks."""
    return "\n".join(_lines(_plain(values), remarks)) + "\n"


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with lists for tuples."""
    plain: dict[str, Any] = json.loads(json.dumps(values))
    return plain


def _units(parameters: type) -> dict[str, str]:
    return {key: note.unit for key, note in notes(parameters).items()}


def _of_rig(rig: Mapping[str, Any], more: Mapping[str, Mapping[str, str]]) -> Remarks:
    friction = rig.get("friction", {})
    units: dict[str, dict[str, str]] = {
        "plant": _units(Plant),
        "friction": {
            key: unit
            for law in FRICTION_MODELS.usable().values()
            for key, unit in _units(law.Parameters).items()
            if key in friction
        },
        **{
            section: _units(family.load(rig[section].get("model", default)).Parameters)
            for section, family, default in (("cylinder", CYLINDERS, "double_rod"), ("valve", VALVES, "load_flow"))
            if section in rig
        },
        "limits": _units(Limits),
    }
    remarks = {
        section: {key: "; ".join(filter(None, [unit, more.get(section, {}).get(key, "")])) for key, unit in own.items()}
        for section, own in units.items()
    }
    sensors = dict.fromkeys(rig.get("sensors", {}), _units(Sensor))
    effects = [_units(EFFECTS.load(use["name"]).Parameters) for use in rig.get("effects", [])]
    return {**remarks, "sensors": sensors, "effects": effects}


def _of_use(family: Family[Any], use: Any) -> Remarks:
    if not isinstance(use, Mapping):
        return {}
    inner = {key: _of_use(FAMILIES[key], value) for key, value in use.items() if key in FAMILIES}
    return {**_units(family.load(use["name"]).Parameters), **inner}


def _lines(values: Mapping[str, Any], remarks: Any, indent: str = "") -> Iterator[str]:
    for key, value in values.items():
        own = remarks.get(key, "")
        if isinstance(value, dict) and value:
            yield f"{indent}{key}:"
            yield from _lines(value, own or {}, f"{indent}  ")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            yield f"{indent}{key}:"
            for entry, inner in zip(value, own or [{}] * len(value), strict=True):
                first, *rest = _lines(entry, inner, f"{indent}    ")
                yield from (f"{indent}  - {first.lstrip()}", *rest)
        else:
            text = yaml.safe_dump([value], default_flow_style=True, allow_unicode=True, width=10**6).strip()[1:-1]
            line = f"{indent}{key}: {text}"
            yield f"{line:<{COLUMN}} # {own}" if own else line
