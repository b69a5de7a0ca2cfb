"""Compiled entries of the control side, called from Python once per cycle."""

from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

from ehls_ros.control import servo_model
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import ControllerLaw
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.observers.base import FrictionObserver
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.friction.base import FrictionModel


def controller_kernel(name: str) -> ModuleType:
    """Return a module with the compiled law of one controller as ``step``, and its ``follow`` if it has one."""
    law = CONTROLLERS.load(name)
    entries = {"step": "m, r, f, p, model, memory, status"}
    if hasattr(law, "follow"):
        entries["follow"] = "command, own, memory"
    return compiled(law_itself, entries, {"law": law})


def observer_kernel(name: str, model: str) -> ModuleType:
    """Return a module with the compiled ``update`` of one friction observer, for one friction model."""
    members = {"observer": OBSERVERS.load(name), "friction": FRICTION_MODELS.load(model)}
    return compiled(build_observer, {"update": "velocity, period, friction, p, state"}, members)


def law_itself(law: ControllerLaw) -> ControllerLaw:
    """Return a controller's file unchanged, as its functions need no building."""
    return law


def servo_kernel() -> ModuleType:
    """Return a module with ``foresee``, the compiled preview of the motion of a position servo and the loader."""
    return compiled(servo_model.build, {"foresee": "rows, commands, both"})


class Observer(NamedTuple):
    """A friction observer built for one friction model.

    Attributes:
        update: update of :mod:`ehls_ros.control.observers.base`.
    """

    update: Callable[..., None]


def build_observer(observer: FrictionObserver, friction: FrictionModel) -> Observer:
    """Build an observer for a friction model."""
    return Observer(observer.updater(friction))
