"""Disturbances by the actuator under test, one file per kind; ``base`` defines the interface of a file."""

from ehls_ros.control.disturbances.base import DisturbanceKind
from ehls_ros.families import Family

DISTURBANCES: Family[DisturbanceKind] = Family("ehls_ros.control.disturbances", "disturbance", DisturbanceKind)
