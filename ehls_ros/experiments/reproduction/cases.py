"""The paper's cases as experiments, with one tuning for all of them."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.loop import Implausible, run_in_process
from ehls_ros.experiments.metrics import Metrics, evaluate
from ehls_ros.experiments.reproduction import paper
from ehls_ros.experiments.reproduction.paper import Cell
from ehls_ros.experiments.spec import Spec, load_rig, spec_from_mapping
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

PARTS: dict[str, dict[str, Any]] = {
    paper.SIC: {"controller": {"name": "sic"}},
    paper.FASMC_1: {"controller": {"name": "fasmc"}, "compensation": {"name": "stribeck"}},
    paper.FASMC_2: {"controller": {"name": "fasmc"}, "compensation": {"name": "gms"}},
}
"""Controller and friction observer of each row of Table 3; their parameters are the declared defaults."""

DIVERGED = 2e3
"""Largest steady error from which on a run counts as diverged [N]: a fifth of the largest reference."""


class Change(NamedTuple):
    """What a run has other than the case of the paper.

    Attributes:
        sections: keys of the spec; a mapping adds to the section's own.
        plant: factors by which the plant's coefficients are off from what the controller believes.
        friction: the same for the friction's.
    """

    sections: Mapping[str, Any] = {}
    plant: Mapping[str, float] = {}
    friction: Mapping[str, float] = {}


AS_PUBLISHED = Change()


@cache
def paper_rig() -> Rig:
    """Return the paper's rig."""
    return load_rig(config_folder() / "rig_paper.yaml")


def case(cell: Cell, change: Change = AS_PUBLISHED) -> Spec:
    """Return the experiment of one cell.

    Args:
        cell: the combination.
        change: what is other than in the paper.
    """
    sections: dict[str, Any] = {
        "title": " ".join(cell),
        "rig": str(config_folder() / "rig_paper.yaml"),
        "reference": paper.REFERENCES[cell.reference],
        "disturbance": {"name": "force", "signal": paper.DISTURBANCES[cell.disturbance]},
        **PARTS[cell.controller],
    }
    for key, value in change.sections.items():
        own = sections.get(key)
        sections[key] = {**own, **value} if isinstance(own, Mapping) and isinstance(value, Mapping) else value
    spec = spec_from_mapping(sections, f"case {cell}", Path())
    return spec._replace(rig=_off(spec.rig, change))


def _off(rig: Rig, change: Change) -> Rig:
    plant = {name: factor * getattr(rig.plant, name) for name, factor in change.plant.items()}
    friction = {name: factor * getattr(rig.friction, name) for name, factor in change.friction.items()}
    return rig._replace(plant=rig.plant._replace(**plant), friction=rig.friction._replace(**friction))


def run(cell: Cell, change: Change = AS_PUBLISHED) -> Trajectory:
    """Run one cell."""
    return run_in_process(case(cell, change))


def judged(cell: Cell, change: Change = AS_PUBLISHED) -> Metrics:
    """Run one cell and return its metrics alone."""
    return evaluate(run(cell, change))


def largest_error(cell: Cell, change: Change = AS_PUBLISHED) -> float:
    """Run one cell and return its largest steady error [N]; infinite when it diverged."""
    try:
        error = judged(cell, change).max_error_n
    except Implausible:
        return float("inf")
    return error if error < DIVERGED else float("inf")
