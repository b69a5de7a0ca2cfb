"""The paper's cases as experiments, with one tuning for all."""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from ehls_ros.experiments.batch import run_batch
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import Metrics, evaluate, evaluate_errors
from ehls_ros.experiments.run_failure import Implausible
from ehls_ros.experiments.spec import Spec, load_rig, spec_from_mapping
from ehls_ros.physics.friction import gms
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.paper import Cell
from ehls_ros.trajectory import Trajectory

PARTS: dict[str, dict[str, Any]] = {
    paper.SIC: {"controller": {"name": "sic"}},
    paper.FASMC_1: {"controller": {"name": "fasmc"}, "compensation": {"name": "stribeck"}},
    paper.FASMC_2: {"controller": {"name": "fasmc"}, "compensation": {"name": "gms"}},
}
"""Controller and friction observer of each row of Table 3; their parameters are the declared defaults."""

DIVERGED = 2e3
"""Steady error above which a run counts as diverged [N]: a fifth of the largest reference."""


class Change(NamedTuple):
    """Differences of a run from the paper's case.

    Attributes:
        sections: keys of the spec; a mapping is merged into that of the section.
        plant: factors on the plant's coefficients relative to those of the controller's design.
        friction: the same for the friction's coefficients.
        known_friction: factors on the friction's coefficients of both plant and controller.
    """

    sections: Mapping[str, Any] = {}
    plant: Mapping[str, float] = {}
    friction: Mapping[str, float] = {}
    known_friction: Mapping[str, float] = {}


AS_PUBLISHED = Change()

Coefficients = TypeVar("Coefficients", Plant, gms.Parameters)


@cache
def paper_rig() -> Rig:
    """Return the paper's rig."""
    return load_rig(config_folder() / "rig_paper.yaml")


def case(cell: Cell, change: Change = AS_PUBLISHED) -> Spec:
    """Return the experiment of one cell.

    Args:
        cell: the combination.
        change: its differences from the paper's case.
    """
    sections: dict[str, Any] = {
        "title": " ".join(cell),
        "rig": str(config_folder() / "rig_paper.yaml"),
        "reference": paper.REFERENCES[cell.reference],
        "disturbance": {"name": "force", "signal": paper.DISTURBANCES[cell.disturbance]},
        **PARTS[cell.controller],
    }
    for key, value in change.sections.items():
        usual = sections.get(key)
        sections[key] = {**usual, **value} if isinstance(usual, Mapping) and isinstance(value, Mapping) else value
    spec = spec_from_mapping(sections, f"case {cell}", Path())
    believed = spec.controller_rig._replace(friction=_scaled(spec.controller_rig.friction, change.known_friction))
    plant, friction = spec.rig.plant, _scaled(_scaled(spec.rig.friction, change.known_friction), change.friction)
    return spec._replace(rig=spec.rig._replace(plant=_scaled(plant, change.plant), friction=friction), controller_rig=believed)


def _scaled(parameters: Coefficients, factors: Mapping[str, float]) -> Coefficients:
    """Return a parameter set with some coefficients scaled, those of several elements by the same factor."""
    values = parameters._asdict()
    scaled: dict[str, Any] = {
        name: tuple(factor * value for value in values[name]) if isinstance(values[name], tuple) else factor * values[name]
        for name, factor in factors.items()
    }
    return parameters._replace(**scaled)


def run(cell: Cell, change: Change = AS_PUBLISHED) -> Trajectory:
    """Run one cell."""
    # Some readings of the paper describe a rig that the checks of a rig file reject; they are tried nevertheless.
    return run_in_process(case(cell, change), check=not change.known_friction)


def evaluated(cell: Cell, change: Change = AS_PUBLISHED) -> Metrics:
    """Run one cell and return its metrics."""
    return evaluate(run(cell, change))


def largest_error(cell: Cell, change: Change = AS_PUBLISHED) -> float:
    """Run one cell and return its largest steady error [N]; infinite when it diverged."""
    try:
        return _finite(evaluated(cell, change).max_error_n)
    except Implausible:
        return math.inf


def largest_errors(runs: Sequence[tuple[Cell, Change]]) -> list[float]:
    """Run cells side by side and return the result of :func:`largest_error` for each."""
    errors = [math.inf] * len(runs)
    for place, result in run_batch((case(*each) for each in runs), brief=True):
        if isinstance(result, Trajectory):
            errors[place] = _finite(evaluate_errors(result).max_error_n)
        elif not isinstance(result, Implausible):
            raise result
    return errors


def _finite(error: float) -> float:
    return error if error < DIVERGED else math.inf
