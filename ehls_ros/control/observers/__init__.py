"""Friction observers, one file each; ``base`` defines the interface of a file."""

from ehls_ros.control.observers.base import FrictionObserver
from ehls_ros.families import Family
from ehls_ros.physics.rig import Rig

OBSERVERS: Family[FrictionObserver] = Family("ehls_ros.control.observers", "friction observer", FrictionObserver)

ANY_MODEL = "rig_model"
"""The observer that supports any friction model."""


def default_observer(rig: Rig) -> str:
    """Return the default observer of a rig: the one named like its friction model, otherwise that for any model."""
    return rig.friction_model if rig.friction_model in OBSERVERS.names() else ANY_MODEL
