"""Parameters: declared once with unit, range and help, and checked against that declaration.

A parameter set is a ``NamedTuple`` whose fields are annotated with :func:`quantity`. Compiled kernels accept it directly.
YAML checks, ROS descriptors, command-line help and the tables in the documentation are derived from the annotations.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

from ehls_ros.errors import BadInput, one_of

Parameters = TypeVar("Parameters")


class Note(NamedTuple):
    """Declaration of a value beside its type; for a list, only unit and text."""

    description: str = ""
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()
    typical: Any = None
    scale: str = ""

    @property
    def text(self) -> str:
        """Description, unit and scaling of the default; empty if nothing is declared."""
        return _described(self.description, self.unit, self.scale) if self.description else ""

    def explained(self) -> str:
        """Return description, unit, range and a typical value in brackets; empty if nothing is declared."""
        if not self.description:
            return ""
        unit = f" [{self.unit}]" if self.unit else ""
        low = self.above if self.minimum is None else self.minimum
        span = "" if low is None or self.maximum is None else f", {low:g} to {self.maximum:g}"
        typical = "" if self.typical is None else f", such as {plain_text(self.typical)}"
        return f" ({self.description}{unit}{span}{typical})"


def _described(description: str, unit: str, scale: str) -> str:
    origin = f"; default in proportion to the rig's {scale}" if scale else ""
    return description + (f" [{unit}]" if unit else "") + origin


def plain_text(value: float | tuple[float, ...]) -> str:
    """Format a number or a list of numbers as short YAML text with six significant digits."""
    return f"[{', '.join(map(plain_text, value))}]" if isinstance(value, tuple) else f"{value:g}"


class Misfit(ValueError):
    """A value that does not fit its declaration."""

    def __init__(self, value: Any, expected: str, place: str = "") -> None:
        """Keep the parts of the message.

        Args:
            value: the offending value.
            expected: description of acceptable values.
            place: position within the declared value, such as ``[2]`` in a list.
        """
        super().__init__(f"{value!r}; expected {expected}")
        self.value = value
        self.expected = expected
        self.place = place


def quantity(
    unit: str,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    above: float | None = None,
    typical: float | None = None,
    scale: str = "",
) -> Note:
    """Declare a number with a unit, for ``Annotated[float, ...]``.

    Args:
        unit: SI unit; ``1`` for a dimensionless number.
        description: one sentence of help.
        minimum: smallest accepted value.
        maximum: largest accepted value.
        above: the value must be larger than this.
        typical: a usual value, for errors and for users without one.
        scale: quantities of the rig to which the default is proportional, such as ``force`` or ``1 / pressure``; the declared
            default is that of the paper's rig.
    """
    return Note(description, unit, minimum, maximum, above, typical=typical, scale=scale)


def text(description: str, unit: str = "", choices: Sequence[str] = (), typical: tuple[float, ...] | None = None) -> Note:
    """Declare a field other than a number, such as a name or a list.

    Args:
        description: one sentence of help.
        unit: unit of a list's entries.
        choices: the texts that are accepted; empty: any.
        typical: a usual list.
    """
    return Note(description, unit, choices=tuple(choices), typical=typical)


class Declaration(NamedTuple):
    """Declaration of one parameter; the bounds include exclusive ones."""

    name: str
    kind: Any
    default: Any
    unit: str
    minimum: float | None
    maximum: float | None
    description: str
    scale: str

    @property
    def text(self) -> str:
        """Description, unit and scaling of the default."""
        return _described(self.description, self.unit, self.scale)


class Field(NamedTuple):
    """Declaration of a field: its type without the note, and the note."""

    kind: Any
    note: Note


def fields_of(parameters: Any) -> Mapping[str, Field]:
    """Return the declaration of each field of a ``NamedTuple`` class."""
    return _fields_of(parameters)


@cache
def _fields_of(parameters: Any) -> Mapping[str, Field]:
    # get_type_hints evaluates the annotations at each call.
    hints = get_type_hints(parameters, include_extras=True)
    return MappingProxyType({name: _annotated(hint) for name, hint in hints.items()})


def declarations(parameters: type) -> Iterator[Declaration]:
    """Yield the declarations of a parameter set, in order.

    Args:
        parameters: a ``NamedTuple`` class whose fields carry :func:`quantity`.

    Yields:
        One entry per field; ``default`` is ``None`` if the field has none.
    """
    defaults: Mapping[str, Any] = getattr(parameters, "_field_defaults", {})
    for name, (kind, note) in fields_of(parameters).items():
        low = note.above if note.minimum is None else note.minimum
        yield Declaration(name, kind, defaults.get(name), note.unit, low, note.maximum, note.description, note.scale)


def scaled_defaults(
    parameters: type, ratios: Mapping[str, float], stated: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """Return the defaults scaled to a rig, by name.

    Args:
        parameters: a ``NamedTuple`` class whose fields carry :func:`quantity`.
        ratios: ratio of each of the rig's quantities to that of the rig for which defaults are declared.
        stated: defaults that replace the declared ones, for the same rig.

    Returns:
        A value for each field with a ``scale``, within its range, and those of ``stated``.
    """
    scaled = dict(stated)
    for declared in declarations(parameters):
        default = stated.get(declared.name, declared.default)
        if declared.scale and default is not None:
            value = default * _ratio(declared.scale, ratios)
            low, high = declared.minimum, declared.maximum
            value = value if low is None else max(value, low)
            scaled[declared.name] = value if high is None else min(value, high)
    return scaled


def _ratio(scale: str, ratios: Mapping[str, float]) -> float:
    """Return a product of ratios, such as ``mass * pressure`` or ``1 / force``."""
    ratio, times = 1.0, True
    for word in scale.split():
        if word in {"*", "/"}:
            times = word == "*"
        elif word != "1":
            ratio = ratio * ratios[word] if times else ratio / ratios[word]
    return ratio


def parse(
    parameters: type[Parameters], data: Mapping[str, Any], where: str, absent: Mapping[str, Any] | None = None
) -> Parameters:
    """Check a mapping against a parameter set and build it.

    Args:
        parameters: the ``NamedTuple`` class to build.
        data: the user's values. An int is accepted for a float, and a float without a fraction for an int; nothing else
            is converted: YAML's ``yes`` is not 1, and a quoted number is text.
        where: file and section, for the error.
        absent: values of keys that may be missing, in place of their defaults.

    Returns:
        The parameter set.

    Raises:
        BadInput: names the first offending key, its value and the expected value.
    """
    fields = fields_of(parameters)
    values = dict(absent or {})
    defaults = getattr(parameters, "_field_defaults", {})
    if not fields.keys() >= data.keys():
        unknown = next(key for key in data if key not in fields)
        raise BadInput(f"key '{unknown}' is unknown", where, one_of(unknown, fields))
    for key, (kind, note) in fields.items():
        if key in data:
            try:
                values[key] = _fitted(kind, note, data[key])
            except Misfit as misfit:
                what = f"{key}{misfit.place} is {misfit.value!r}"
                raise BadInput(what, where, f"{misfit.expected}{_advice(misfit)}{note.explained()}") from None
        elif key not in defaults and key not in values:
            raise missing_key(key, note, where)
    return parameters(**values)


def missing_key(key: str, note: Note, where: str) -> BadInput:
    """Return the error for a missing required key."""
    return BadInput(f"key '{key}' is missing", where, f"a value for it{note.explained()}")


def notes(parameters: type) -> dict[str, Note]:
    """Return the note of each field of a parameter set."""
    return {name: field.note for name, field in fields_of(parameters).items()}


def from_json(kind: Any, document: str | bytes) -> Any:
    """Read a JSON document.

    Args:
        kind: type of the content, as for :func:`fitted`.
        document: its text.

    Raises:
        ValueError: the document is not valid JSON (NaN is not either), or its content has another type.
    """
    try:
        data = json.loads(document, parse_constant=_refuse)
        # A lone surrogate is valid in a str, but cannot be encoded.
        json.dumps(data, ensure_ascii=False).encode()
    except RecursionError:
        raise Misfit("a list of lists of lists", "a document of a few levels") from None
    return fitted(kind, data)


def _refuse(constant: str) -> None:
    raise Misfit(constant, "a number of JSON")


def fitted(kind: Any, value: Any) -> Any:
    """Convert a value to its declared type: ints to floats and lists to tuples where declared.

    Args:
        kind: a plain type, ``Any``, ``Literal``, an optional type, a tuple, sequence or mapping of such, or a ``NamedTuple``
            class; each may be annotated with a :class:`Note`.
        value: the value.

    Raises:
        Misfit: the value has another type or is out of range.
    """
    return _fitted(*_annotated(kind), value)


def _fitted(kind: Any, note: Note, value: Any) -> Any:
    made = _of_type(kind, value)
    if made is None:
        return None
    if note.minimum is not None and made < note.minimum:
        raise Misfit(value, f"a value greater than or equal to {note.minimum:.15g}")
    if note.above is not None and made <= note.above:
        raise Misfit(value, f"a value greater than {note.above:.15g}")
    if note.maximum is not None and made > note.maximum:
        raise Misfit(value, f"a value less than or equal to {note.maximum:.15g}")
    if note.choices and made not in note.choices:
        raise Misfit(value, one_of(value, note.choices))
    return made


def _annotated(hint: Any) -> Field:
    """Split an annotation into type and note."""
    if get_origin(hint) is not Annotated:
        return Field(hint, Note())
    kind, *notes = get_args(hint)
    return Field(kind, next((note for note in notes if isinstance(note, Note)), Note()))


def _of_type(kind: Any, value: Any) -> Any:
    if kind in _PLAIN:
        return _plain(kind, value)
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any or (value is None and NoneType in arguments):
        return value
    if origin in {Union, UnionType}:
        [kind] = set(arguments) - {NoneType}
        return fitted(kind, value)
    if origin is Literal:
        if value not in arguments:
            raise Misfit(value, one_of(value, map(str, arguments)))
        return value
    return _tuple(arguments, value) if origin in {tuple, Sequence} else _mapping(kind, value)


_PLAIN = {bool: "boolean", float: "number", int: "integer", str: "string"}


def _plain(kind: type, value: Any) -> Any:
    """Return a value as a bool, float, int or str."""
    exact = type(value) is kind
    if exact and (kind is not float or math.isfinite(value)):
        return value
    wanted = f"a valid {_PLAIN[kind]}"
    if kind in {bool, str} and isinstance(value, kind):
        return value
    if kind in {bool, str} or isinstance(value, bool) or not isinstance(value, int | float):
        raise Misfit(value, wanted)
    if not abs(value) < math.inf:
        raise Misfit(value, "a finite number" if kind is float else wanted)
    if kind is int and value != int(value):
        raise Misfit(value, wanted)
    try:
        return kind(value)
    except OverflowError:
        raise Misfit(value, "a finite number") from None


def _tuple(kinds: tuple[Any, ...], value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise Misfit(value, "a list")
    if len(kinds) == 1 or kinds[1:] == (...,):
        declared = [_annotated(kinds[0])] * len(value)
    else:
        declared = [_annotated(kind) for kind in kinds]
    if len(value) != len(declared):
        raise Misfit(value, f"a list of {len(declared)} values")
    made = []
    for index, (field, each) in enumerate(zip(declared, value, strict=True)):
        try:
            made.append(_fitted(*field, each))
        except Misfit as misfit:
            raise Misfit(misfit.value, misfit.expected, f"[{index}]{misfit.place}") from None
    return tuple(made)


def _mapping(kind: Any, value: Any) -> Any:
    """Return a mapping as a mapping, or as the ``NamedTuple`` of its entries."""
    if not isinstance(value, Mapping):
        raise Misfit(value, "a mapping of keys to values")
    if get_origin(kind) is Mapping:
        of_keys, of_values = get_args(kind)
        return {fitted(of_keys, key): fitted(of_values, each) for key, each in value.items()}
    try:
        return parse(kind, value, kind.__name__)
    except BadInput as error:
        raise Misfit(value, error.expected) from None


def _advice(misfit: Misfit) -> str:
    """Return a hint at how YAML may have misread the user's value."""
    match misfit.expected, misfit.value:
        case "a valid number" | "a valid integer", bool():
            return " (in YAML, yes, on, no and off mean true and false)"
        case "a valid number" | "a valid integer", str():
            return " without quotes"
        case "a valid string", bool() | int() | float():
            return " in quotes"
        case _:
            return ""
