"""A model for an FMU: its variables, all in one block of numbers, and its compiled functions."""

import math
from collections.abc import Iterable, Mapping, Sequence
from types import ModuleType
from typing import Any, Literal, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.schema import fields_of

Causality = Literal["independent", "parameter", "input", "output", "local"]
Variability = Literal["constant", "fixed", "tunable", "discrete", "continuous"]


class Variable(NamedTuple):
    """A variable of an FMU.

    Attributes:
        name: structured name, such as ``plant.moving_mass``.
        causality: its role.
        variability: when it may change.
        unit: its unit; empty if it has none that is known.
        description: one sentence.
        start: value before initialisation; without meaning if it is calculated.
        minimum, maximum: range, including the bounds.
        above: value that it must exceed.
        rate: index of the variable that is its derivative; None unless it is a state.
    """

    name: str
    causality: Causality
    variability: Variability
    unit: str = "1"
    description: str = ""
    start: float = 0.0
    minimum: float = -math.inf
    maximum: float = math.inf
    above: float | None = None
    rate: int | None = None

    @property
    def settable(self) -> bool:
        """Whether an importer may set it."""
        return self.causality in ("parameter", "input")

    @property
    def calculated(self) -> bool:
        """Whether the model calculates its initial value."""
        return self.causality in ("output", "local") and self.variability != "constant"


def constant(name: str, unit: str, value: float, description: str) -> Variable:
    """Return a constant."""
    return Variable(name, "local", "constant", unit, description, value)


def parameters_of(group: str, values: Any, remark: str = "") -> list[Variable]:
    """Return the numbers of a parameter set as tunable parameters, in order.

    Args:
        group: first part of their names.
        values: a named tuple with declared fields; a list gives a parameter for each entry, a nested tuple a subgroup.
        remark: end of each description.
    """
    found = list[Variable]()
    for key, (_, note) in fields_of(type(values)).items():
        value = getattr(values, key)
        if hasattr(value, "_fields"):
            found += parameters_of(f"{group}.{key}", value, remark)
            continue
        entries = value if isinstance(value, tuple) else (value,)
        for index, entry in enumerate(entries):
            name = f"{group}.{key}[{index + 1}]" if isinstance(value, tuple) else f"{group}.{key}"
            low = -math.inf if note.minimum is None else note.minimum
            high = math.inf if note.maximum is None else note.maximum
            description = f"{note.description or key.replace('_', ' ')}{remark}"
            unit = note.unit or "1"
            found.append(Variable(name, "parameter", "tunable", unit, description, float(entry), low, high, note.above))
    return found


class Block:
    """Layout of a model's numbers: variables first, then memory, then scratch.

    Attributes:
        variables: the variables; the index of each is its value reference.
        memory: initial values of the numbers after them that belong to the state.
        scratch: number of the last numbers, which hold nothing between two calls.
    """

    def __init__(self) -> None:
        """Start empty."""
        self.variables: list[Variable] = []
        self.memory: list[float] = []
        self.scratch = 0

    @property
    def size(self) -> int:
        """Number of numbers so far."""
        return len(self.variables) + len(self.memory) + self.scratch

    def add(self, variables: Iterable[Variable]) -> int:
        """Append variables and return the index of the first; none may follow memory or scratch."""
        if self.memory or self.scratch:
            raise AssertionError("variables after memory or scratch")
        first = len(self.variables)
        self.variables += variables
        return first

    def remember(self, values: Iterable[float]) -> int:
        """Append initial values of the memory and return the index of the first; none may follow scratch."""
        if self.scratch:
            raise AssertionError("memory after scratch")
        first = len(self.variables) + len(self.memory)
        self.memory += map(float, values)
        return first

    def reserve(self, count: int) -> int:
        """Append scratch and return the index of its first number."""
        first = self.size
        self.scratch += count
        return first

    def start(self) -> Array:
        """Return the block before initialisation."""
        return np.array([*(variable.start for variable in self.variables), *self.memory, *([0.0] * self.scratch)])


class Model(NamedTuple):
    """A model ready for export.

    Attributes:
        name: short name.
        description: one sentence.
        block: layout and initial values.
        entries: modules of the compiled functions of one block, by the functions' names: ``start``, ``step`` and, for Model
            Exchange, ``rates`` and ``change``; ``slopes`` for directional derivatives.
        event: index of the event indicator; None without Model Exchange.
        period: sample period [s].
        terminals: names of the variables of each terminal, by the terminal's name.
        seed, slope: indices in the scratch of the seeds and of the derivatives, one for each variable; for ``slopes``.
    """

    name: str
    description: str
    block: Block
    entries: Mapping[str, ModuleType]
    event: int | None
    period: float
    terminals: Mapping[str, Sequence[str]]
    seed: int = 0
    slope: int = 0

    @property
    def states(self) -> list[int]:
        """Indices of the continuous states."""
        return [index for index, variable in enumerate(self.block.variables) if variable.rate is not None]
