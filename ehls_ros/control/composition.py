"""Compiled entries of the control side, callable from Python once a cycle."""

from types import ModuleType

from ehls_ros.physics.composition import kernel_module

_CONTROLLER = '''"""Controller kernel, generated."""
from numba import njit
from ehls_ros.control.controllers import {name} as law


@njit(cache=True, error_model="numpy")
def step(m, r, f, p, model, memory, status):
    return law.step(m, r, f, p, model, memory, status)
'''

_OBSERVER = '''"""Friction observer kernel, generated."""
from numba import njit
from ehls_ros.control.observers import {name} as observer
from ehls_ros.physics.friction import {model} as friction_model

run = observer.updater(friction_model)


@njit(cache=True, error_model="numpy")
def update(velocity, period, friction, p, state):
    run(velocity, period, friction, p, state)
'''


def controller_kernel(name: str) -> ModuleType:
    """Return a module whose ``step`` is the compiled law of one controller."""
    return kernel_module(_CONTROLLER.format(name=name))


def observer_kernel(name: str, model: str) -> ModuleType:
    """Return a module whose ``update`` is the compiled update of one friction observer, for one friction model."""
    return kernel_module(_OBSERVER.format(name=name, model=model))
