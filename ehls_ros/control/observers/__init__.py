"""Friction observers, one file each; ``base`` says what a file provides."""

from ehls_ros.control.observers.base import FrictionObserver
from ehls_ros.families import Family
from ehls_ros.physics.rig import Rig

OBSERVERS: Family[FrictionObserver] = Family("ehls_ros.control.observers", "friction observer")

ANY_MODEL = "rig_model"
"""The observer that runs any friction model."""


def default_observer(rig: Rig) -> str:
    """Return the observer of a rig where none is named: that of its friction model's name, else the one for any model."""
    return rig.friction_model if rig.friction_model in OBSERVERS.names() else ANY_MODEL
