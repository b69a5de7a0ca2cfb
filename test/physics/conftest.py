"""The paper's rig, its simulator, and friction models driven along a given velocity."""

import copy
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml
from reference_solver import Case, Floats
from rig_runs import PAPER_RIG, PERIOD, run

from ehls_ros.physics.composition import kernel_module
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.physics.simulator import Simulator


@pytest.fixture(scope="session")
def paper_mapping() -> dict[str, Any]:
    mapping: dict[str, Any] = yaml.safe_load(PAPER_RIG.read_text(encoding="utf-8"))
    return mapping


@pytest.fixture
def rig_data(paper_mapping: dict[str, Any]) -> dict[str, Any]:
    """Content of the paper's rig file, for modification."""
    return copy.deepcopy(paper_mapping)


@pytest.fixture(scope="session")
def make_rig(paper_mapping: dict[str, Any]) -> Callable[..., Rig]:
    """Return the paper's rig with some keys of its sections changed."""

    def make(plant: dict[str, Any] | None = None, friction: dict[str, Any] | None = None, **sections: Any) -> Rig:
        data = copy.deepcopy(paper_mapping)
        data["plant"].update(plant or {})
        data["friction"].update(friction or {})
        return rig_from_mapping({**data, **sections}, "rig")

    return make


@pytest.fixture(scope="session")
def simulated(make_rig: Callable[..., Rig]) -> Callable[..., Floats]:
    """Return the package's states for a case of the reference solver."""

    def simulate(case: Case, step: float | None = None, friction: dict[str, Any] | None = None) -> Floats:
        rig = make_rig(friction={"model": case.law, **(friction or {})}, effects=case.effects)
        return run(Simulator(rig, case.period, step), case.inputs)

    return simulate


_DRIVE = '''"""A friction model driven along a velocity, generated."""
from math import copysign
from typing import Any, NamedTuple
import numpy as np
from numba import njit
from ehls_ros.arrays import kernel
from ehls_ros.physics import integration
from ehls_ros.physics.friction import {model} as model

# Whatever moves the contact is strong enough to.
STRONG = 1e9


class Motion(NamedTuple):
    friction: Any
    velocity: float
    acceleration: float


@kernel
def evaluate(t, y, mode, c, rate):
    v = c.velocity + c.acceleration * t
    level = model.level(v, c.friction)
    model.rates(v, level, y, mode, c.friction, rate)
    return model.event(v, copysign(STRONG, v), level, y, mode, c.friction)


@kernel
def switch(t, y, mode, c):
    v = c.velocity + c.acceleration * t
    model.switch(v, copysign(STRONG, v), model.level(v, c.friction), y, mode, c.friction)


run = integration.integrator(evaluate, switch)


@njit(cache=True, error_model="numpy")
def drive(velocity, period, steps, friction, y, mode, states, modes, total):
    work = np.empty((integration.WORK_ROWS, y.size))
    dense = 0
    for k in range(velocity.size):
        if k > 0:
            motion = Motion(friction, velocity[k - 1], (velocity[k] - velocity[k - 1]) / period)
            dense += run(0.0, y, mode, motion, period / steps, steps, work)
        states[k] = y
        modes[k] = mode
        level = model.level(velocity[k], friction)
        total[k] = model.force(velocity[k], 0.0, level, y, mode, friction)
    return dense
'''


class Driven:
    """A friction model driven along a velocity: the state of its elements, their modes and the total force."""

    def __init__(self, module: ModuleType, count: int, velocity: Floats, friction: Any, steps: int) -> None:
        y, mode = np.zeros(count), np.zeros(count)
        self.states, self.modes = np.empty((velocity.size, count)), np.empty((velocity.size, count))
        self.total = np.empty(velocity.size)
        assert module.drive(velocity, PERIOD, steps, friction, y, mode, self.states, self.modes, self.total) == 0


@pytest.fixture(scope="session")
def drive() -> Callable[..., Driven]:
    """Drive a friction model along velocities sampled each millisecond, straight lines between."""

    def along(model: str, velocity: Floats, friction: Any, steps: int = 10) -> Driven:
        from ehls_ros.physics.friction import FRICTION_MODELS

        module = kernel_module(_DRIVE.format(model=model))
        count = FRICTION_MODELS.load(model).states(friction)
        return Driven(module, count, np.asarray(velocity, dtype=np.float64), friction, steps)

    return along
