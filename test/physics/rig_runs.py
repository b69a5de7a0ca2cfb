"""Runs of the simulator with given inputs, and effects by stage."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from reference_solver import Floats

from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS, acts_on_one_pressure
from ehls_ros.physics.simulator import Simulator

PAPER_RIG, SINGLE_ROD_RIG = (
    Path(__file__).resolve().parents[2] / "config" / f"rig_{name}.yaml" for name in ("paper", "single_rod")
)
PERIOD = 1e-3


def run(simulator: Simulator, inputs: Floats) -> Floats:
    """Run the commands and disturbances of each cycle; return the states from the start on, shape (cycles + 1, states)."""
    states = [simulator.y.copy()]
    for u, force, rate in inputs.tolist():
        assert simulator.advance(u, force, rate, 0.0, 0.0) == 0
        states.append(simulator.y.copy())
    return np.array(states)


def rig_file_for(name: str) -> Path:
    """Return the rig file of the cylinder in which all parameters of an effect act."""
    effect = EFFECTS.load(name)
    return PAPER_RIG if acts_on_one_pressure(effect) and not hasattr(effect, "ONLY_IN_CHAMBERS") else SINGLE_ROD_RIG


def stage_effects(stage: str, changed: Mapping[str, Mapping[str, float]]) -> list[dict[str, Any]]:
    """Return all effects of a stage that have hooks, as a rig file lists them, some of them with values other than neutral.

    All of them every time, so that the tests of a stage share one kernel.
    """
    effects = {name: EFFECTS.load(name) for name in EFFECTS.names()}
    names = [n for n, e in effects.items() if stage == e.GROUP and any(hasattr(e, hook) for hook in HOOKS)]
    assert set(changed) <= set(names)
    return [{"name": name, **changed.get(name, {})} for name in names]
