"""Map of a foreign FMU's variables to the signals of a plant, with units."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from ehls_ros.errors import BadInput, one_of
from ehls_ros.fmu.model import Causality
from ehls_ros.fmu.unit_definitions import SIGNAL_UNITS
from ehls_ros.physics.rig import CHAMBER_SENSED, SENSED
from ehls_ros.schema import parse, text
from ehls_ros.units import UNITS, unit_of

INPUT_UNITS: Mapping[str, str] = {
    "valve_command": "m",
    "disturbance_force": "N",
    "disturbance_force_rate": "N/s",
    "disturbance_displacement": "m",
    "disturbance_velocity": "m/s",
    "oil_temperature_supplied": "K",
}
"""Inputs of a plant, with their units."""

NEEDED = ("valve_command", "disturbance_force")
"""Inputs without which an FMU is no plant of an experiment."""

OUTPUT_UNITS: Mapping[str, str] = {signal: SIGNAL_UNITS[signal] for signal in (*SENSED, *CHAMBER_SENSED)}

CHAMBERS = frozenset(CHAMBER_SENSED)
"""Readings of a cylinder with two chambers, without which a law takes those of steady motion."""

DERIVED = ("load_pressure", "force", "supply_pressure", "oil_temperature", *CHAMBER_SENSED)
"""Readings that follow from others or from the rig file where the FMU has none, or that the law can do without."""

Section = Literal["inputs", "outputs"]


class Entry(NamedTuple):
    """Variable of a signal."""

    variable: Annotated[str, text("name of the FMU's variable")]
    unit: Annotated[str, text("its unit, such as mm or bar; by default that of the model description")] = ""
    factor: Annotated[float, text("factor on the variable, such as -1 for the other direction", "1")] = 1.0
    minus: Annotated[str, text("for an output: a second variable of the same unit, which is subtracted")] = ""


class PlantMap(NamedTuple):
    """Content of a map.

    Attributes:
        inputs, outputs: variables by signal.
        parameters: values of the FMU's parameters, in its own units.
    """

    inputs: Mapping[str, Entry] = {}
    outputs: Mapping[str, Entry] = {}
    parameters: Mapping[str, float] = {}


class Described(NamedTuple):
    """A variable as the FMU declares it."""

    name: str
    reference: int
    causality: Causality
    unit: str
    kind: str


class Link(NamedTuple):
    """A signal's variable: signal = scale (value - value of ``minus``) + offset, in SI units.

    Attributes:
        signal: name of the signal.
        reference: value reference.
        scale, offset: of the conversion.
        minus: value reference of the variable that is subtracted; None for none.
    """

    signal: str
    reference: int
    scale: float
    offset: float
    minus: int | None = None


class Wiring(NamedTuple):
    """The links of a plant.

    Attributes:
        inputs: inputs that the FMU has.
        outputs: readings that the FMU has.
        parameters: values by value reference.
    """

    inputs: tuple[Link, ...]
    outputs: tuple[Link, ...]
    parameters: Mapping[int, float]


def map_from_mapping(data: Any, where: str) -> PlantMap:
    """Build a map from the content of its file.

    Args:
        data: the parsed file, with the sections inputs, outputs and parameters.
        where: the file, for errors.

    Raises:
        BadInput: a section, signal or key is unknown, or a value is wrong.
    """
    sections = PlantMap._fields
    if not isinstance(data, Mapping) or not set(data) <= set(sections):
        unknown = next((key for key in data if key not in sections), "") if isinstance(data, Mapping) else type(data).__name__
        raise BadInput(f"{unknown!r} is no section of a map", where, f"a mapping with {', '.join(sections)}")
    for section in sections:
        if not isinstance(data.get(section, {}), Mapping):
            raise BadInput(f"{section} is {data[section]!r}", where, "a mapping")
    known = {"inputs": INPUT_UNITS, "outputs": OUTPUT_UNITS}
    found: dict[str, dict[str, Entry]] = {"inputs": {}, "outputs": {}}
    for section, signals in known.items():
        for signal, entry in data.get(section, {}).items():
            place = f"{where}: {section}"
            if signal not in signals:
                raise BadInput(f"signal {signal!r} is unknown", place, one_of(signal, signals))
            given = {"variable": entry} if isinstance(entry, str) else entry
            if not isinstance(given, Mapping):
                raise BadInput(f"{signal} is {entry!r}", place, "the name of a variable, or {variable: x, unit: mm}")
            found[section][signal] = parse(Entry, given, f"{place}: {signal}")
    parameters = data.get("parameters", {})
    for name, value in parameters.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInput(f"{name} is {value!r}", f"{where}: parameters", "a number in the unit of the FMU's parameter")
    return PlantMap(found["inputs"], found["outputs"], {str(name): float(value) for name, value in parameters.items()})


def wired(
    variables: Mapping[str, Described],
    plant_map: PlantMap,
    where: str,
    start: Mapping[str, float],
    sensed: Sequence[str],
) -> Wiring:
    """Match a map with the variables of an FMU; a signal that is not in the map is the variable of its name, if there is one.

    Args:
        variables: the FMU's variables.
        plant_map: the map.
        where: FMU and map, for errors.
        start: values of parameters that an exported rig has, such as its initial position.
        sensed: signals of the rig.

    Raises:
        BadInput: a variable is missing or has another causality or type, units do not fit, or a needed signal has none.
    """
    inputs = _links(variables, plant_map.inputs, INPUT_UNITS, "input", where)
    for signal in set(plant_map.outputs) - set(sensed):
        raise BadInput(f"the rig file's cylinder has no {signal}", f"{where}: outputs", "cylinder: {model: two_chamber}")
    outputs = _links(variables, plant_map.outputs, {signal: OUTPUT_UNITS[signal] for signal in sensed}, "output", where)
    has = {link.signal for link in (*inputs, *outputs)}
    for signal in (*NEEDED, *(name for name in sensed if name not in DERIVED)):
        if signal not in has:
            section: Section = "inputs" if signal in INPUT_UNITS else "outputs"
            raise BadInput(f"the FMU has no variable {signal}", where, f"a map with the entry {section}: {signal}")
    if not (has & {"load_pressure", "force"} or has >= CHAMBERS):
        both = " or both pressures" if set(sensed) >= CHAMBERS else ""
        expected = "a map with the entry outputs: load_pressure"
        raise BadInput(f"the FMU has neither load_pressure nor force{both}", where, expected)
    values = {name: value for name, value in start.items() if name in variables}
    parameters = {
        _found(variables, name, "parameter", where).reference: value
        for name, value in {**values, **plant_map.parameters}.items()
    }
    return Wiring(inputs, outputs, parameters)


def _links(
    variables: Mapping[str, Described],
    entries: Mapping[str, Entry],
    units: Mapping[str, str],
    causality: Causality,
    where: str,
) -> tuple[Link, ...]:
    links = []
    for signal, wanted in units.items():
        entry = entries.get(signal)
        if entry is None:
            if signal not in variables or variables[signal].causality != causality:
                continue
            entry = Entry(signal)
        variable = _found(variables, entry.variable, causality, where)
        minus = _found(variables, entry.minus, causality, where).reference if entry.minus else None
        scale, offset = _conversion(entry, variable, wanted, f"{where}: {signal}")
        links.append(Link(signal, variable.reference, scale, 0.0 if entry.minus else offset, minus))
    return tuple(links)


def _found(variables: Mapping[str, Described], name: str, causality: Causality, where: str) -> Described:
    """Return a real variable of a causality; any output or local variable can be read.

    Raises:
        BadInput: there is none.
    """
    if name not in variables:
        raise BadInput(f"the FMU has no variable {name!r}", where, one_of(name, variables))
    variable = variables[name]
    readable = ("output", "local", "calculatedParameter")
    if variable.causality not in (readable if causality == "output" else (causality,)):
        raise BadInput(f"{name} is of causality {variable.causality}", where, f"an {causality} for this signal")
    if variable.kind not in ("Real", "Float64"):
        raise BadInput(f"{name} is of type {variable.kind}", where, "a variable of type Real or Float64")
    return variable


def _conversion(entry: Entry, variable: Described, wanted: str, where: str) -> tuple[float, float]:
    """Return scale and offset from the variable's unit to the SI unit of its signal.

    Raises:
        BadInput: a unit is unknown or of another quantity, or the map contradicts the model description.
    """
    if entry.factor == 0.0:
        raise BadInput("factor is 0", where, "a factor other than 0")
    given, declared = entry.unit or variable.unit, variable.unit
    if given == wanted and declared in ("", given):
        return entry.factor, 0.0
    if not given:
        raise BadInput(f"{variable.name} has no unit", where, f"a map with its unit, such as {wanted}")
    unit, target = unit_of(given), unit_of(wanted)
    if unit is None or target is None or UNITS[unit].quantity != UNITS[target].quantity:
        raise BadInput(f"{variable.name} is in {given}", where, f"a unit of the same quantity as {wanted}")
    if entry.unit and declared and unit_of(declared) not in (None, unit):
        raise BadInput(
            f"{variable.name} is in {declared}, not {entry.unit}", where, f"the unit of the model description, {declared}"
        )
    return entry.factor * UNITS[unit].scale, UNITS[unit].offset
