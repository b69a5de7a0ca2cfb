"""Variations in a campaign file: a list, a range or a distribution instead of one value."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.random import Generator

from ehls_ros.errors import BadInput
from ehls_ros.schema import parse, quantity, text

RELATIVE = text("the numbers are factors on the base's own value")


class Values(NamedTuple):
    """List of values; with ``relative``, factors on the base's value."""

    values: tuple[Any, ...]
    relative: bool = False


class Range(NamedTuple):
    """Numbers from ``start`` to ``stop``, both included."""

    start: Annotated[float, quantity("as the value", "first number")]
    stop: Annotated[float, quantity("as the value", "last number")]
    points: Annotated[int, quantity("1", "how many numbers", minimum=2, maximum=100_000)]
    spacing: Annotated[Literal["linear", "log"], text("equal steps or equal ratios")] = "linear"
    relative: Annotated[bool, RELATIVE] = False


class Distribution(NamedTuple):
    """Distribution of random numbers, one per draw; exactly one of the three is given."""

    uniform: Annotated[tuple[float, float] | None, text("lowest and highest number")] = None
    normal: Annotated[tuple[float, float] | None, text("mean and standard deviation")] = None
    loguniform: Annotated[tuple[float, float] | None, text("lowest and highest number, the logarithm being uniform")] = None
    relative: Annotated[bool, RELATIVE] = False

    def draw(self, random: Generator) -> float:
        """Draw a number."""
        if self.uniform is not None:
            return float(random.uniform(*self.uniform))
        if self.normal is not None:
            return float(random.normal(*self.normal))
        low, high = self.loguniform or (1.0, 1.0)
        return float(math.exp(random.uniform(math.log(low), math.log(high))))

    @property
    def middle(self) -> float:
        """Median of the distribution."""
        if self.uniform is not None:
            return 0.5 * (self.uniform[0] + self.uniform[1])
        if self.normal is not None:
            return self.normal[0]
        low, high = self.loguniform or (1.0, 1.0)
        return math.sqrt(low * high)


DISTRIBUTIONS = ("uniform", "normal", "loguniform")
EXPECTED = (
    "a list, {start, stop, points}, or a distribution {uniform: [low, high]}, {normal: [mean, std]}, {loguniform: [low, high]}"
)


def variation(data: Any, where: str) -> Values | Distribution:
    """Check the entry of a campaign file for a path.

    Args:
        data: the parsed entry.
        where: file and path, for errors.

    Raises:
        BadInput: it is none of the three, or inconsistent.
    """
    if isinstance(data, list):
        if not data:
            raise BadInput("the list is empty", where, "at least one value")
        return Values(tuple(data))
    if not isinstance(data, Mapping):
        raise BadInput(f"entry is {data!r}", where, EXPECTED)
    if any(name in data for name in DISTRIBUTIONS):
        return _distribution(data, where)
    if "start" in data or "stop" in data or "points" in data:
        return _numbers(parse(Range, data, where), where)
    raise BadInput(f"entry is {dict(data)!r}", where, EXPECTED)


def _numbers(wanted: Range, where: str) -> Values:
    if wanted.spacing == "linear":
        numbers = np.linspace(wanted.start, wanted.stop, wanted.points)
    elif wanted.start * wanted.stop > 0.0:
        numbers = np.geomspace(wanted.start, wanted.stop, wanted.points)
    else:
        raise BadInput(f"start is {wanted.start:g}, stop is {wanted.stop:g}", where, "two numbers of one sign for spacing: log")
    return Values(tuple(numbers.tolist()), wanted.relative)


def _distribution(data: Mapping[str, Any], where: str) -> Distribution:
    chosen = parse(Distribution, data, where)
    given = {name: pair for name in DISTRIBUTIONS if (pair := getattr(chosen, name)) is not None}
    if len(given) != 1:
        raise BadInput(f"{' and '.join(given) or 'no distribution'} given", where, f"one of {', '.join(DISTRIBUTIONS)}")
    [(name, (first, second))] = given.items()
    if not (math.isfinite(first) and math.isfinite(second)):
        raise BadInput(f"{name} is [{first:g}, {second:g}]", where, "two finite numbers")
    if name == "normal" and second < 0.0:
        raise BadInput(f"normal is [{first:g}, {second:g}]", where, "a mean and a standard deviation of 0 or more")
    if name != "normal" and not first <= second:
        raise BadInput(f"{name} is [{first:g}, {second:g}]", where, "[low, high] with low <= high")
    if name == "loguniform" and first <= 0.0:
        raise BadInput(f"loguniform is [{first:g}, {second:g}]", where, "numbers above 0")
    return chosen


def label(value: Any) -> Any:
    """Return a value as a cell of a table: numbers unchanged, sections and lists as text.

    Args:
        value: value of a path in a campaign file, such as ``{name: sine, amplitude: 1e4}``.
    """
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        name = str(value.get("name", ""))
        return " ".join([name, *(f"{key}={_short(entry)}" for key, entry in value.items() if key != "name")]).strip()
    if isinstance(value, Sequence) and any(isinstance(entry, Mapping) for entry in value):
        return " + ".join(str(label(entry)) for entry in value)
    return _short(value) if value else "none"


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return "{" + str(label(value)) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(_short(entry) for entry in value) + "]"
    return str(value)
