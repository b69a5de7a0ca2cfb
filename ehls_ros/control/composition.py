"""Compiled entries of the control side, callable from Python once a cycle."""

from types import ModuleType

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import ControllerLaw
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.observers.base import FrictionObserver
from ehls_ros.physics.composition import compiled


def controller_kernel(name: str) -> ModuleType:
    """Return a module whose ``step`` is the compiled law of one controller."""
    return compiled(law_itself, {"step": "m, r, f, p, model, memory, status"}, {"law": CONTROLLERS.load(name)})


def observer_kernel(name: str) -> ModuleType:
    """Return a module whose ``update`` is the compiled update of one friction observer."""
    return compiled(observer_itself, {"update": "velocity, period, friction, p, state"}, {"observer": OBSERVERS.load(name)})


def law_itself(law: ControllerLaw) -> ControllerLaw:
    """Build what a controller's file has built already."""
    return law


def observer_itself(observer: FrictionObserver) -> FrictionObserver:
    """Build what an observer's file has built already."""
    return observer
