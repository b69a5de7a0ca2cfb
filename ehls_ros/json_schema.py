"""JSON Schema of declared parameters, for editors that complete and check YAML."""

from collections.abc import Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from ehls_ros.schema import Note, notes

Schema = dict[str, Any]

_PLAIN = {bool: "boolean", float: "number", int: "integer", str: "string"}


def schema_of(kind: Any) -> Schema:
    """Return the schema of a type that :func:`ehls_ros.schema.fitted` takes.

    Args:
        kind: a plain type, ``Any``, ``Literal``, an optional type, a tuple, sequence or mapping of such, or a ``NamedTuple``
            class; each may be annotated with a :class:`ehls_ros.schema.Note`.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        own, *others = arguments
        return _with_note(schema_of(own), next((note for note in others if isinstance(note, Note)), Note()))
    if kind is Any or kind in _PLAIN:
        return {"type": _PLAIN[kind]} if kind in _PLAIN else {}
    if origin in {Union, UnionType}:
        [one] = set(arguments) - {NoneType}
        return {"anyOf": [schema_of(one), {"type": "null"}]}
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin in {tuple, Sequence}:
        return _list(arguments)
    return {"type": "object", "additionalProperties": schema_of(arguments[1])} if origin is Mapping else object_of(kind)


def _list(kinds: tuple[Any, ...]) -> Schema:
    if len(kinds) == 1 or kinds[1:] == (...,):
        return {"type": "array", "items": schema_of(kinds[0])}
    return {"type": "array", "items": [schema_of(kind) for kind in kinds], "minItems": len(kinds), "maxItems": len(kinds)}


def object_of(parameters: type, needed: Sequence[str] | None = None, **more: Schema) -> Schema:
    """Return the schema of a parameter set.

    Args:
        parameters: a ``NamedTuple`` class.
        needed: required keys; by default those without a default value.
        more: schemas of further keys.
    """
    hints = get_type_hints(parameters, include_extras=True)
    defaults: Mapping[str, Any] = getattr(parameters, "_field_defaults", {})
    properties = {key: schema_of(hint) for key, hint in hints.items()}
    for key, note in notes(parameters).items():
        if key in defaults and defaults[key] is not None and note.description:
            properties[key]["default"] = defaults[key]
    required = [key for key in hints if key not in defaults] if needed is None else list(needed)
    return mapping_of({**properties, **more}, required)


def mapping_of(properties: Mapping[str, Schema], required: Sequence[str] = ()) -> Schema:
    """Return the schema of a mapping with these keys and no others."""
    return {"type": "object", "properties": dict(properties), "required": list(required), "additionalProperties": False}


def _with_note(schema: Schema, note: Note) -> Schema:
    bounds = {"minimum": note.minimum, "exclusiveMinimum": note.above, "maximum": note.maximum}
    own = next((one for one in schema.get("anyOf", ()) if one.get("type") != "null"), schema)
    own |= {word: bound for word, bound in bounds.items() if bound is not None}
    if note.choices:
        own["enum"] = list(note.choices)
    if note.description:
        schema["description"] = note.text
    if note.typical is not None:
        schema["examples"] = [note.typical]
    return schema
