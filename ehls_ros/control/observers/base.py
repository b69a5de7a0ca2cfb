"""Interface of the file of a friction observer.

A file has ``Parameters``, a named tuple that declares its parameters; ``state(model, friction)``, an :class:`ObserverState`
before the first cycle; and ``updater(model)``, which builds the compiled ``update(velocity, period, friction, p, state)`` for a
friction model. ``update`` processes one more measured velocity [m/s] and writes to ``state.estimate``: total force of the
elements, viscous force [N], then the force of each element [N], then for each element 1 if it slips and 0 if it sticks. A
velocity that is not finite is replaced by the last one (:func:`held`).

An observer that supports only one friction model names it in ``FRICTION_MODEL``.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.errors import BadInput
from ehls_ros.families import Family
from ehls_ros.physics.friction.base import FrictionModel
from ehls_ros.physics.integration import WORK_ROWS
from ehls_ros.physics.rig import Rig

ELEMENTS = 2
"""Index of the first element force in an estimate."""


class ObserverState(NamedTuple):
    """State of an observer.

    Attributes:
        forces: forces of the elements [N].
        mode: modes of the elements, as in :mod:`ehls_ros.physics.friction.base`.
        last: last velocity [m/s], and 1 after the first velocity.
        work: scratch of the integrator.
        estimate: the result, shape (2 + 2 elements,).
    """

    forces: Array
    mode: Array
    last: Array
    work: Array
    estimate: Array


class FrictionObserver(Protocol):
    """The attributes of an observer's file; ``FRICTION_MODEL`` is optional."""

    Parameters: Any

    def state(self, model: FrictionModel, friction: Any) -> ObserverState:
        """Return the state before the first cycle, for a friction model and its parameters."""

    def updater(self, model: FrictionModel) -> Callable[..., None]:
        """Return the compiled update for a friction model."""


def empty_state(elements: int) -> ObserverState:
    """Return a state at rest for a number of elements."""
    return ObserverState(
        np.zeros(elements), np.zeros(elements), np.zeros(2), np.empty((WORK_ROWS, elements)), np.zeros(2 + 2 * elements)
    )


@kernel
def held(velocity: float, state: ObserverState) -> float:
    """Return and store a measured velocity [m/s], or the last good one if it is not finite."""
    if not math.isfinite(velocity):
        velocity = state.last[0]
    state.last[0], state.last[1] = velocity, 1.0
    return velocity


def supports(member: Any, rig: Rig) -> bool:
    """Return whether an observer or controller supports the friction model of a rig."""
    return getattr(member, "FRICTION_MODEL", rig.friction_model) == rig.friction_model


def check_friction_support(family: Family[Any], name: str, rig: Rig, where: str) -> None:
    """Check that an observer or controller supports the friction model of a rig.

    Args:
        family: observers or controllers.
        name: name of the observer or controller.
        rig: the rig as described to the controller.
        where: file and section, for error messages.

    Raises:
        BadInput: it supports only another model.
    """
    if not supports(family.load(name, where), rig):
        what = f"{family.noun} {name!r} does not support friction model {rig.friction_model!r}"
        followed = getattr(family.load(name), "FOLLOWS", None)
        others = {other: family.load(other) for other in family.names()}
        able = [
            other for other, member in others.items() if supports(member, rig) and getattr(member, "FOLLOWS", None) == followed
        ]
        only = others[name].FRICTION_MODEL
        raise BadInput(what, where, f"one of {', '.join(able)}; or a rig whose friction model is {only}")
