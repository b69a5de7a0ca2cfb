"""Parameters: declared once with unit, range and help, and checked by pydantic.

A parameter set is a ``NamedTuple`` whose fields are annotated with :func:`quantity`. Compiled kernels accept it directly.
YAML checks, ROS descriptors, command-line help and the tables in the documentation are derived from the annotations.
"""

from collections.abc import Hashable, Iterator, Mapping
from functools import cache
from typing import Annotated, Any, NamedTuple, TypeVar, cast, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from ehls_ros.errors import BadInput

Parameters = TypeVar("Parameters")


def quantity(
    unit: str,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    above: float | None = None,
) -> Any:
    """Declare a finite number with a unit, for ``Annotated[float, ...]``.

    Args:
        unit: SI unit; ``1`` for a dimensionless number.
        description: one sentence of help.
        minimum: smallest accepted value.
        maximum: largest accepted value.
        above: the value must be larger than this.

    Returns:
        The pydantic field.
    """
    return Field(
        ge=minimum,
        le=maximum,
        gt=above,
        allow_inf_nan=False,
        description=description,
        json_schema_extra={"unit": unit},
    )


def text(description: str, unit: str = "") -> Any:
    """Declare a field other than a number, such as a name or a list, with one sentence of help and the unit of its entries."""
    return Field(description=description, json_schema_extra={"unit": unit})


class Declaration(NamedTuple):
    """Declaration of one parameter; the bounds include exclusive ones."""

    name: str
    kind: Any
    default: Any
    unit: str
    minimum: float | None
    maximum: float | None
    description: str


def declarations(parameters: type) -> Iterator[Declaration]:
    """Yield the declarations of a parameter set, in order.

    Args:
        parameters: a ``NamedTuple`` class whose fields carry :func:`quantity`.

    Yields:
        One entry per field; ``default`` is ``None`` if the field has none.
    """
    defaults: Mapping[str, Any] = getattr(parameters, "_field_defaults", {})
    for name, hint in get_type_hints(parameters, include_extras=True).items():
        kind, *notes = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        field = next((note for note in notes if isinstance(note, FieldInfo)), FieldInfo())
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        limits = {key: getattr(item, key) for item in field.metadata for key in ("ge", "gt", "le") if hasattr(item, key)}
        yield Declaration(
            name=name,
            kind=kind,
            default=defaults.get(name),
            unit=str(extra.get("unit", "")),
            minimum=limits.get("ge", limits.get("gt")),
            maximum=limits.get("le"),
            description=field.description or "",
        )


def parse(parameters: type[Parameters], data: Mapping[str, Any], where: str) -> Parameters:
    """Check a mapping against a parameter set and build it.

    Args:
        parameters: the ``NamedTuple`` class to build.
        data: the user's values. An int is accepted for a float, and a float without a fraction for an int; nothing else
            is converted: YAML's ``yes`` is not 1, and a quoted number is text.
        where: file and section, for the error.

    Returns:
        The parameter set.

    Raises:
        BadInput: naming the first offending key, its value and what was expected.
    """
    try:
        return cast(Parameters, _adapter(cast(Hashable, parameters)).validate_python(_prepared(parameters, data)))
    except ValidationError as error:
        raise bad_input(error, where, parameters) from None


@cache
def _adapter(parameters: Any) -> TypeAdapter[Any]:
    """Return the validator of a parameter set; cached, as building one takes milliseconds."""
    return TypeAdapter(parameters, config=ConfigDict(strict=True))


def _prepared(parameters: type, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the data for the validator: lists as tuples, and whole floats as ints for fields declared as int."""
    integers = {declared.name for declared in declarations(parameters) if declared.kind is int}
    return {
        key: int(value) if key in integers and isinstance(value, float) and value.is_integer() else _frozen(value)
        for key, value in data.items()
    }


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _as_written(value: Any) -> Any:
    return list(map(_as_written, value)) if isinstance(value, tuple) else value


def bad_input(error: ValidationError, where: str, parameters: type) -> BadInput:
    """Return pydantic's first error as one line."""
    first = error.errors(include_url=False)[0]
    # The key of a list is enough, without the index.
    location = tuple(part for part in first["loc"] if isinstance(part, str))
    key = ".".join(location)
    explained = _help(parameters, location)
    written = _as_written(first["input"])
    match first["type"]:
        case "missing" | "missing_argument" if location == first["loc"]:
            return BadInput(f"key '{key}' is missing", where, f"a value for it {explained}".rstrip())
        case "missing":
            return BadInput(f"{key} is {written!r}", where, f"more values {explained}".rstrip())
        case "extra_forbidden" | "unexpected_keyword_argument":
            known = ", ".join(_fields_at(parameters, location[:-1]))
            return BadInput(f"key '{key}' is unknown", where, f"one of {known}" if known else "no such key")
        case _:
            expected = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
            advice = _advice(first["type"], first["input"])
            return BadInput(f"{key} is {written!r}", where, f"{expected}{advice} {explained}".rstrip())


def _advice(kind: str, value: Any) -> str:
    """Return a hint at how YAML may have misread the user's value."""
    match kind, value:
        case "float_type" | "int_type", bool():
            return " (in YAML, yes, on, no and off mean true and false)"
        case "float_type" | "int_type", str():
            return " without quotes"
        case "string_type", bool() | int() | float():
            return " in quotes"
        case _:
            return ""


def _fields_at(parameters: Any, location: tuple[str, ...]) -> tuple[str, ...]:
    for part in location:
        hints = get_type_hints(parameters) if hasattr(parameters, "_fields") else {}
        parameters = hints.get(part)
    return tuple(getattr(parameters, "_fields", ()))


def _help(parameters: Any, location: tuple[str, ...]) -> str:
    for part in location[:-1]:
        hints = get_type_hints(parameters) if hasattr(parameters, "_fields") else {}
        parameters = hints.get(part)
    if not location or not hasattr(parameters, "_fields"):
        return ""
    for declared in declarations(parameters):
        if declared.name == location[-1] and declared.description:
            unit = f" [{declared.unit}]" if declared.unit else ""
            bounded = declared.minimum is not None and declared.maximum is not None
            span = f", {declared.minimum:g} to {declared.maximum:g}" if bounded else ""
            return f"({declared.description}{unit}{span})"
    return ""
