"""Plan of a campaign: its file and its runs.

The grid is every combination of the lists, ranges and zipped groups. Every draw of random numbers is run at every point of the
grid, so that points are compared on the same draws. A drawn number depends only on the campaign's seed, the draw and the path.
Any run can therefore be repeated alone, and further draws or paths do not change it.
"""

import copy
import itertools
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ehls_ros.errors import BadInput, one_of
from ehls_ros.experiments.campaign.variation import Distribution, Values, label, variation
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import SECTIONS, Spec, spec_from_mapping, spec_to_mapping
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import declarations, parse, quantity, text

MAX_POINTS, MAX_RUNS = 100_000, 1_000_000
"""Largest number of grid points, and of runs."""

KEYS = ("title", "base", "vary", "zip", "runs", "seed")

SEED = "seed"
"""Path with a different number in each draw, unless the campaign varies it."""


class Settings(NamedTuple):
    """Scalar settings of a campaign file."""

    title: Annotated[str, text("title of the campaign in its report")] = "campaign"
    runs: Annotated[int, quantity("1", "draws at each point of the grid", minimum=1, maximum=MAX_RUNS)] = 1
    seed: Annotated[int, quantity("1", "seed of everything drawn", minimum=0)] = 0


class Point(NamedTuple):
    """One combination of the grid.

    Attributes:
        values: entry in the table for each path of the grid.
        spec: the spec with the content of all referenced files, as JSON.
    """

    values: dict[str, Any]
    spec: str


class Run(NamedTuple):
    """One experiment of a campaign.

    Attributes:
        number: number from 0; all points of the grid in turn, then the next draw.
        draw: number of the draw, from 0.
        values: entry in the table for each varied path.
        spec: the spec with the content of all referenced files, as JSON.
    """

    number: int
    draw: int
    values: dict[str, Any]
    spec: str


class Column(NamedTuple):
    """A varied path as a column of the table.

    Attributes:
        path: dotted path into the spec.
        unit: unit of its numbers; empty if none.
        numeric: whether all its values are numbers.
        drawn: whether it is drawn at random.
    """

    path: str
    unit: str
    numeric: bool
    drawn: bool


@dataclass(frozen=True)
class Plan:
    """A checked campaign.

    Attributes:
        settings: title, draws, seed.
        points: the grid; one point if only draws are varied.
        drawn: distribution of each drawn path.
        random: whether ``runs`` is given, so that paths or at least the seed are drawn.
        columns: the varied paths.
        cycles: control cycles of the longest run of the grid.
        file: content of the campaign's YAML file, with its base written out.
    """

    settings: Settings
    points: tuple[Point, ...]
    drawn: dict[str, Distribution]
    random: bool
    columns: tuple[Column, ...]
    cycles: int
    file: dict[str, Any]

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.points) * self.settings.runs

    def runs(self) -> Iterator[Run]:
        """Yield the runs in their order."""
        for draw in range(self.settings.runs):
            numbers = self._numbers(draw)
            for index in range(len(self.points)):
                yield self._run(draw, index, numbers)

    def run(self, number: int) -> Run:
        """Make one run.

        Args:
            number: number of the run, from 0.

        Raises:
            BadInput: there is no such run.
        """
        if not 0 <= number < len(self):
            raise BadInput(f"run {number} is unknown", "campaign", f"0 to {len(self) - 1}")
        draw, index = divmod(number, len(self.points))
        return self._run(draw, index, self._numbers(draw))

    def _numbers(self, draw: int) -> dict[str, float]:
        """Draw a number for each drawn path, and for the seed if there are draws."""
        if not self.random:
            return {}
        seed = int(self._generator(draw, SEED).integers(2**31))
        return {SEED: seed} | {path: drawn.draw(self._generator(draw, path)) for path, drawn in self.drawn.items()}

    def _run(self, draw: int, index: int, numbers: Mapping[str, float]) -> Run:
        """Make the run of a draw at a point of the grid."""
        point, number = self.points[index], draw * len(self.points) + index
        if not self.random:
            return Run(number, draw, point.values, point.spec)
        spec, values = json.loads(point.spec), dict(point.values)
        for path, distribution in self.drawn.items():
            values[path] = _set(spec, path, numbers[path], path, relative=distribution.relative)
        if SEED not in values:
            values[SEED] = spec[SEED] = numbers[SEED]
        return Run(number, draw, values, json.dumps(spec))

    def _generator(self, draw: int, path: str) -> np.random.Generator:
        return np.random.default_rng([self.settings.seed, draw, zlib.crc32(path.encode())])


def load_plan(path: Path) -> Plan:
    """Read a campaign file; files named in it are relative to its folder.

    Raises:
        BadInput: the file, one of its keys or a run of its grid is wrong.
    """
    return plan_from_mapping(read_yaml(path, "campaign"), str(path), path.parent)


def plan_from_mapping(data: Any, where: str, folder: Path) -> Plan:
    """Check a campaign and build the plan.

    Args:
        data: the parsed file.
        where: the file, for errors.
        folder: base folder of relative file names.

    Returns:
        The plan, every point of its grid a valid spec.

    Raises:
        BadInput: names the first error.
    """
    if not isinstance(data, Mapping):
        raise BadInput(f"a campaign is {type(data).__name__}", where, f"a mapping with keys of {', '.join(KEYS)}")
    for key in data:
        if key not in KEYS:
            raise BadInput(f"key {key!r} is unknown", where, one_of(key, KEYS))
    settings = parse(Settings, {key: data[key] for key in Settings._fields if key in data}, where)
    base = _base(data.get("base"), where, folder)
    groups, drawn = _varied(data, where, folder)
    if drawn and "runs" not in data:
        raise BadInput("key 'runs' is missing", where, f"how often to draw {', '.join(drawn)}")
    count = int(np.prod([len(group) for group in groups], dtype=object))
    if count > MAX_POINTS or count * settings.runs > MAX_RUNS:
        expected = f"at most {MAX_POINTS} points and {MAX_RUNS} runs"
        raise BadInput(f"the grid has {count} points for {settings.runs} runs each", where, expected)
    points, cycles = [], 0
    for combination in itertools.product(*groups):
        changes = {path: change for group in combination for path, change in group.items()}
        point, spec = _point(base, changes, where, folder)
        points.append(point)
        cycles = max(cycles, spec.cycles)
        if drawn:
            _check_draws(point, drawn, where)
    spec = spec_from_mapping(json.loads(points[0].spec), where, folder)
    random = "runs" in data
    columns = _columns(points, drawn, spec, seeded=random)
    file = {**settings._asdict(), "base": base, **{key: _anywhere(data[key], folder) for key in ("vary", "zip") if key in data}}
    if not random:
        del file["runs"]
    return Plan(settings, tuple(points), drawn, random, columns, cycles, file)


class _Change(NamedTuple):
    value: Any
    relative: bool


_Group = list[dict[str, _Change]]
"""Values varied together: a sequence of changes by path."""


def _base(data: Any, where: str, folder: Path) -> dict[str, Any]:
    if isinstance(data, str):
        path = configured(data, "experiments", folder)
        spec = spec_from_mapping(read_yaml(path, "base"), str(path), path.parent)
    elif isinstance(data, Mapping):
        spec = spec_from_mapping(data, f"{where}: base", folder)
    else:
        raise BadInput(f"base is {data!r}", where, "an experiment's file or its content")
    return _written_out(spec)


def _written_out(spec: Spec) -> dict[str, Any]:
    mapping: dict[str, Any] = json.loads(json.dumps(spec_to_mapping(spec)))
    return mapping


def _varied(data: Mapping[str, Any], where: str, folder: Path) -> tuple[list[_Group], dict[str, Distribution]]:
    """Return the groups whose combinations form the grid, and the drawn paths."""
    vary = data.get("vary") or {}
    zipped = data.get("zip") or []
    if not isinstance(vary, Mapping):
        raise BadInput(f"vary is {vary!r}", where, "a mapping of dotted paths such as controller.k")
    if not isinstance(zipped, list) or not all(isinstance(group, Mapping) and group for group in zipped):
        raise BadInput(f"zip is {zipped!r}", where, "a list of mappings, each of paths that change together")
    groups: list[_Group] = []
    drawn: dict[str, Distribution] = {}
    for path, entry in vary.items():
        place = f"{where}: vary: {path}"
        found = variation(_anywhere(entry, folder), _checked(path, [*drawn, *_paths(groups)], place))
        if isinstance(found, Distribution):
            drawn[path] = found
        else:
            groups.append([{path: _Change(value, found.relative)} for value in found.values])
    for number, group in enumerate(zipped):
        columns: dict[str, list[_Change]] = {}
        for path, entry in group.items():
            place = f"{where}: zip[{number}]: {path}"
            found = variation(_anywhere(entry, folder), _checked(path, [*drawn, *_paths(groups)], place))
            if not isinstance(found, Values):
                raise BadInput("a distribution is zipped", place, "a list or a range; distributions belong under vary")
            columns[path] = [_Change(value, found.relative) for value in found.values]
        lengths = {path: len(changes) for path, changes in columns.items()}
        if len(set(lengths.values())) != 1:
            given = ", ".join(f"{path} has {length}" for path, length in lengths.items())
            raise BadInput(given, f"{where}: zip[{number}]", "equally many values for each path")
        groups.append([dict(zip(columns, together, strict=True)) for together in zip(*columns.values(), strict=True)])
    return groups, drawn


def _paths(groups: Sequence[_Group]) -> list[str]:
    return [path for group in groups for path in group[0]]


def _checked(path: Any, before: Sequence[str], place: str) -> str:
    if not isinstance(path, str) or path.split(".")[0] not in SECTIONS:
        raise BadInput(f"path {path!r} is unknown", place, f"a dotted path that starts with one of {', '.join(SECTIONS)}")
    if path in before:
        raise BadInput(f"path {path!r} is varied twice", place, "each path once")
    return place


def _anywhere(data: Any, folder: Path, key: str = "") -> Any:
    """Return data with all file names as absolute paths, valid in any folder."""
    if isinstance(data, Mapping):
        return {name: _anywhere(value, folder, name) for name, value in data.items()}
    if isinstance(data, list):
        return [_anywhere(value, folder, key) for value in data]
    return str((folder / data).resolve()) if isinstance(data, str) and key in {"file", "rig", "controller_rig"} else data


def _point(base: Mapping[str, Any], changes: Mapping[str, _Change], where: str, folder: Path) -> tuple[Point, Spec]:
    """Return a point of the grid and its spec: complete sections first, then values within them."""
    mapping: dict[str, Any] = copy.deepcopy(dict(base))
    values = {path: label(change.value) for path, change in changes.items()}
    place = f"{where}: {', '.join(f'{path} = {value}' for path, value in values.items())}" if values else where
    inside = dict(changes)
    for path, change in changes.items():
        if "." not in path:
            mapping[path] = _set(mapping, path, inside.pop(path).value, place, relative=change.relative)
    spec = spec_from_mapping(mapping, place, folder)
    mapping = _written_out(spec)
    for path, change in sorted(inside.items(), key=lambda item: item[0].count(".")):
        set_to = _set(mapping, path, change.value, place, relative=change.relative)
        values[path] = label(set_to)
    if inside:
        spec = spec_from_mapping(mapping, place, folder)
        mapping = _written_out(spec)
    for path, change in changes.items():
        if change.relative:
            values[path] = _get(mapping, path, place)
    return Point(values, json.dumps(mapping)), spec


def _check_draws(point: Point, drawn: Mapping[str, Distribution], where: str) -> None:
    """Reject paths that a spec does not have, by a check with the median of every distribution."""
    mapping = json.loads(point.spec)
    for path, distribution in drawn.items():
        _set(mapping, path, distribution.middle, f"{where}: vary: {path}", relative=distribution.relative)
    spec_from_mapping(mapping, f"{where}: the medians of the drawn values", Path())


def _set(mapping: dict[str, Any], path: str, value: Any, where: str, *, relative: bool) -> Any:
    """Set a value in nested mappings and lists, as a factor on the present one if relative; return the value set."""
    *way, last = path.split(".")
    inner: Any = mapping
    for step in way:
        # Optional keys, such as a sensor, may be set; unknown ones are rejected by the check of the spec.
        inner = inner.setdefault(step, {}) if isinstance(inner, dict) and not relative else _inside(inner, step, path, where)
    if relative:
        own = _inside(inner, last, path, where)
        if isinstance(own, bool | str) or not isinstance(own, int | float) or not isinstance(value, int | float):
            raise BadInput(f"{path} is {own!r} times {value!r}", where, "numbers where values are relative")
        value = own * value
    if isinstance(inner, dict):
        inner[last] = value
    else:
        _inside(inner, last, path, where)
        inner[int(last)] = value
    return value


def _get(mapping: dict[str, Any], path: str, where: str) -> Any:
    inner: Any = mapping
    for step in path.split("."):
        inner = _inside(inner, step, path, where)
    return inner


def _inside(inner: Any, step: str, path: str, where: str) -> Any:
    if isinstance(inner, dict) and step in inner:
        return inner[step]
    if isinstance(inner, list) and step.isdigit() and int(step) < len(inner):
        return inner[int(step)]
    if isinstance(inner, dict):
        expected = f"one of {', '.join(inner)}"
    elif isinstance(inner, list):
        expected = f"a number below {len(inner)}"
    else:
        expected = f"a path that ends before {step!r}"
    raise BadInput(f"path {path!r} is unknown at {step!r}", where, expected)


def _columns(points: Sequence[Point], drawn: Mapping[str, Distribution], spec: Spec, *, seeded: bool) -> tuple[Column, ...]:
    def numeric(path: str) -> bool:
        return all(isinstance(point.values[path], int | float) and not isinstance(point.values[path], bool) for point in points)

    columns = [Column(path, _unit(spec, path), numeric(path), drawn=False) for path in points[0].values]
    columns += [Column(path, _unit(spec, path), numeric=True, drawn=True) for path in drawn]
    if seeded and SEED not in {column.path for column in columns}:
        columns.append(Column(SEED, "1", numeric=True, drawn=True))
    return tuple(columns)


def _unit(spec: Spec, path: str) -> str:
    """Return the declared unit of a number in a spec; empty if it has none."""
    *way, last = path.split(".")
    holder: Any = spec if way else spec.settings
    for step in way:
        if isinstance(holder, Mapping):
            holder = holder.get(step)
        elif isinstance(holder, tuple) and step.isdigit():
            holder = holder[int(step)] if int(step) < len(holder) else None
        else:
            holder = getattr(holder, step, None)
    parameters = getattr(holder, "parameters", holder)
    if not hasattr(parameters, "_fields"):
        return ""
    return next((declared.unit for declared in declarations(type(parameters)) if declared.name == last), "")
