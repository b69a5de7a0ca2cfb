"""The header ``model.h`` with which the C part of an FMU is compiled: sizes and declarations of one model."""

import json
import math
from collections.abc import Iterable

from ehls_ros.fmu.model import Model, Variable


def header(model: Model, token: str) -> str:
    """Return the text of ``model.h``.

    Args:
        model: the model.
        token: instantiation token.
    """
    block, states = model.block, model.states
    visible = len(block.variables)
    saved = visible + len(block.memory)
    variables = block.variables
    outputs = [index for index, variable in enumerate(variables) if variable.causality == "output"]
    numbers: dict[str, int] = {
        "VISIBLE": visible,
        "SAVED": saved,
        "VISIBLE_AND_MEMORY": saved,
        "BLOCK": max(block.size, saved + 1),
        "FIRST_OUTPUT": outputs[0],
        "AFTER_OUTPUTS": outputs[-1] + 1,
        "HAS_RATES": int(model.event is not None),
        "HAS_SLOPES": int("slopes" in model.entries),
        "SEED": model.seed,
        "SLOPE": model.slope,
        "MODEL_NUMBER": int(token.strip("{}").replace("-", "")[:7], 16),
    }
    if model.event is not None:
        rate = variables[states[0]].rate
        numbers |= {"STATES": len(states), "FIRST_STATE": states[0], "FIRST_RATE": rate or 0, "EVENT_INDICATOR": model.event}
    lines = [f"#define {name} {value}" for name, value in numbers.items()]
    lines += [
        f"#define TOKEN {json.dumps(token)}",
        _array("double", "START", "SAVED", map(_number, block.start()[:saved])),
        _array("unsigned char", "KIND", "VISIBLE", map(_kind, variables)),
        _array("double", "MINIMUM", "VISIBLE", (_number(_least(variable)) for variable in variables)),
        _array("double", "MAXIMUM", "VISIBLE", (_number(min(variable.maximum, 1.7e308)) for variable in variables)),
        _array("char *const", "NAME", "VISIBLE", (json.dumps(variable.name) for variable in variables)),
        _array("char *const", "UNIT", "VISIBLE", (json.dumps(variable.unit) for variable in variables)),
    ]
    if model.event is not None:
        lines.append(_array("double", "NOMINAL", "STATES", (_number(nominal(variables[place])) for place in states)))
    return "\n".join(lines) + "\n"


def nominal(variable: Variable) -> float:
    """Return the usual size of a state, for the tolerances of an importer's solver."""
    return {"m": 1e-3, "m/s": 1e-2, "Pa": 1e5, "N": 10.0}.get(variable.unit, 1e-3)


def _array(kind: str, name: str, length: str, values: Iterable[str]) -> str:
    return f"static const {kind} {name}[{length}] __attribute__((unused)) = {{{', '.join(values)}}};"


def _number(value: float) -> str:
    return float(value).hex()


def _least(variable: Variable) -> float:
    if variable.above is not None:
        return math.nextafter(variable.above, math.inf)
    return max(variable.minimum, -1.7e308)


def _kind(variable: Variable) -> str:
    if variable.causality == "input":
        return "INPUT"
    if variable.causality != "parameter":
        return "READ_ONLY"
    return "FIXED" if variable.variability == "fixed" else "TUNABLE"
