"""DAQ backends, one file each; ``base`` defines their interface."""

from ehls_ros.families import Family
from ehls_ros.hardware.backends.base import Backend

BACKENDS: Family[Backend] = Family("ehls_ros.hardware.backends", "DAQ backend", Backend)
