"""The identified GMS model run along the measured velocity: the compensation of FASMC II."""

from ehls_ros.control.observers.rig_model import Parameters, around, driven, state, updater

__all__ = ["FRICTION_MODEL", "Parameters", "around", "driven", "state", "updater"]

FRICTION_MODEL = "gms"
