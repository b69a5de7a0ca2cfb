"""Friction compensation of FASMC II: the identified GMS model driven by the measured velocity."""

from ehls_ros.control.observers.rig_model import Parameters, around, driven, state, updater

__all__ = ["FRICTION_MODEL", "Parameters", "around", "driven", "state", "updater"]

FRICTION_MODEL = "gms"
