"""``modelDescription.xml`` and ``terminalsAndIcons.xml`` of an FMU, for FMI 2.0 and 3.0."""

import math
from collections.abc import Iterable
from typing import Literal
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from ehls_ros import __version__
from ehls_ros.fmu.header import nominal
from ehls_ros.fmu.model import Model, Variable
from ehls_ros.fmu.unit_definitions import BASE, base_unit

Version = Literal["2.0", "3.0"]

LICENSE = "Apache-2.0"

STOP_TIME = 10.0
"""Default duration of a simulation [s]."""


def description(model: Model, version: Version, token: str, generated: str) -> bytes:
    """Return ``modelDescription.xml``.

    Args:
        model: the model.
        version: of FMI.
        token: instantiation token.
        generated: date and time of the export, as in XML.
    """
    root = Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": model.name,
            "guid" if version == "2.0" else "instantiationToken": token,
            "description": model.description,
            "generationTool": f"ehls_ros {__version__}",
            "generationDateAndTime": generated,
            "license": LICENSE,
            "variableNamingConvention": "structured",
        },
    )
    if version == "2.0":
        root.set("numberOfEventIndicators", "0" if model.event is None else "1")
    _interfaces(root, model, version)
    _units(root, model.block.variables)
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", {"name": "logStatusError", "description": "reason for a refused call"})
    SubElement(root, "DefaultExperiment", {"startTime": "0.0", "stopTime": str(STOP_TIME), "stepSize": repr(model.period)})
    variables = SubElement(root, "ModelVariables")
    add = _scalar_variable if version == "2.0" else _float64
    by_rate = {variable.rate: index for index, variable in enumerate(model.block.variables) if variable.rate is not None}
    for index, variable in enumerate(model.block.variables):
        add(variables, index, variable, by_rate.get(index))
    _structure(root, model, version)
    return _text(root)


def _text(root: Element) -> bytes:
    indent(root)
    found: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
    return found + b"\n"


def _interfaces(root: Element, model: Model, version: Version) -> None:
    state = "State" if version == "3.0" else "state"
    common = {"modelIdentifier": model.name, f"canGetAndSetFMU{state}": "true", f"canSerializeFMU{state}": "true"}
    if model.event is not None:
        exchanging = SubElement(root, "ModelExchange", common)
        if "slopes" in model.entries:
            exchanging.set(f"providesDirectionalDerivative{'s' if version == '3.0' else ''}", "true")
    stepping = SubElement(root, "CoSimulation", {**common, "canHandleVariableCommunicationStepSize": "true"})
    if version == "3.0":
        stepping.set("fixedInternalStepSize", repr(model.period))
    else:
        stepping.set("canNotUseMemoryManagementFunctions", "true")


def _units(root: Element, variables: Iterable[Variable]) -> None:
    definitions = SubElement(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in variables if variable.unit}):
        defined, found = SubElement(definitions, "Unit", {"name": unit}), base_unit(unit)
        if found is None:
            continue
        values = {name: str(power) for name, power in zip(BASE, found.exponents, strict=True) if power}
        SubElement(defined, "BaseUnit", values | ({"factor": repr(found.factor)} if found.factor != 1.0 else {}))


def _common(index: int, variable: Variable) -> dict[str, str]:
    given = {
        "name": variable.name,
        "valueReference": str(index),
        "causality": variable.causality,
        "variability": variable.variability,
    }
    return given | ({"description": variable.description} if variable.description else {})


def _numeric(variable: Variable) -> dict[str, str]:
    numbers = {"min": variable.minimum if variable.above is None else variable.above, "max": variable.maximum}
    given = {"unit": variable.unit} if variable.unit else {}
    given |= {name: repr(float(value)) for name, value in numbers.items() if math.isfinite(value)}
    if variable.rate is not None:
        given |= {"nominal": repr(nominal(variable)), "reinit": "true"}
    if variable.causality != "independent" and not variable.calculated:
        given["start"] = repr(float(variable.start))
    return given


def _initial(variable: Variable) -> dict[str, str]:
    if variable.calculated:
        return {"initial": "calculated"}
    return {} if variable.causality in ("independent", "input") else {"initial": "exact"}


def _scalar_variable(parent: Element, index: int, variable: Variable, state: int | None) -> None:
    scalar = SubElement(parent, "ScalarVariable", {**_common(index, variable), **_initial(variable)})
    real = SubElement(scalar, "Real", _numeric(variable))
    if state is not None:
        real.set("derivative", str(state + 1))


def _float64(parent: Element, index: int, variable: Variable, state: int | None) -> None:
    own = SubElement(parent, "Float64", {**_common(index, variable), **_initial(variable), **_numeric(variable)})
    if state is not None:
        own.set("derivative", str(state))


def _structure(root: Element, model: Model, version: Version) -> None:
    structure, variables = SubElement(root, "ModelStructure"), model.block.variables
    outputs = [index for index, variable in enumerate(variables) if variable.causality == "output"]
    rates = [rate for place in model.states if (rate := variables[place].rate) is not None]
    initial = sorted([*outputs, *model.states, *rates])
    if version == "3.0":
        groups = {"Output": outputs, "ContinuousStateDerivative": rates, "InitialUnknown": initial}
        groups |= {"EventIndicator": [] if model.event is None else [model.event]}
        for name, places in groups.items():
            for place in places:
                SubElement(structure, name, {"valueReference": str(place)})
        return
    for name, places in {"Outputs": outputs, "Derivatives": rates, "InitialUnknowns": initial}.items():
        if places:
            group = SubElement(structure, name)
            for place in places:
                SubElement(group, "Unknown", {"index": str(place + 1)})


def terminals(model: Model) -> bytes:
    """Return ``terminalsAndIcons.xml`` of FMI 3.0."""
    root = Element("fmiTerminalsAndIcons", {"fmiVersion": "3.0"})
    SubElement(
        SubElement(root, "GraphicalRepresentation"),
        "CoordinateSystem",
        {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100", "suggestedScalingFactorTo_mm": "0.1"},
    )
    SubElement(
        root.find("GraphicalRepresentation") or root,
        "Icon",
        {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"},
    )
    listed = SubElement(root, "Terminals")
    known = {variable.name: variable for variable in model.block.variables}
    for name, members in model.terminals.items():
        terminal = SubElement(listed, "Terminal", {"name": name, "matchingRule": "plug"})
        for member in members:
            SubElement(
                terminal,
                "TerminalMemberVariable",
                {"variableName": known[member].name, "memberName": member, "variableKind": "signal"},
            )
    return _text(root)
