"""Cylinders with their volume balances, one file each; ``base`` defines the interface of a file."""

from ehls_ros.families import Family
from ehls_ros.physics.cylinder.base import Cylinder

CYLINDERS: Family[Cylinder] = Family("ehls_ros.physics.cylinder", "cylinder", Cylinder)
"""The cylinders by file name."""
