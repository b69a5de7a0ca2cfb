"""Compiled entries of the control side, callable from Python once a cycle."""

from types import ModuleType

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.physics.composition import kernel_module
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.sources import import_line

_CONTROLLER = '''"""Controller kernel, generated."""
from numba import njit
{law}


@njit(cache=True, error_model="numpy")
def step(m, r, f, p, model, memory, status):
    return law.step(m, r, f, p, model, memory, status)
'''

_OBSERVER = '''"""Friction observer kernel, generated."""
from numba import njit
{observer}
{model}

run = observer.updater(friction_model)


@njit(cache=True, error_model="numpy")
def update(velocity, period, friction, p, state):
    run(velocity, period, friction, p, state)
'''


def controller_kernel(name: str) -> ModuleType:
    """Return a module whose ``step`` is the compiled law of one controller."""
    return kernel_module(_CONTROLLER.format(law=import_line(CONTROLLERS.load(name), "law")))


def observer_kernel(name: str, model: str) -> ModuleType:
    """Return a module whose ``update`` is the compiled update of one friction observer, for one friction model."""
    observer, law = import_line(OBSERVERS.load(name), "observer"), import_line(FRICTION_MODELS.load(model), "friction_model")
    return kernel_module(_OBSERVER.format(observer=observer, model=law))
