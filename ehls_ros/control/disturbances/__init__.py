"""What the actuator under test does to the loader, one file a kind; ``base`` says what a file provides."""

from ehls_ros.control.disturbances.base import DisturbanceKind
from ehls_ros.families import Family

DISTURBANCES: Family[DisturbanceKind] = Family("ehls_ros.control.disturbances", "disturbance", DisturbanceKind)
