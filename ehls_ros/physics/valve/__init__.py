"""Valves: flow through the metering edges, one file each; ``base`` defines the interface of a file."""

from ehls_ros.families import Family
from ehls_ros.physics.valve.base import Valve

VALVES: Family[Valve] = Family("ehls_ros.physics.valve", "valve", Valve)
"""The valves by file name."""
