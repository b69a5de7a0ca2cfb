"""Companions that work beside any controller, one file each; ``base`` defines the interface of a file."""

from ehls_ros.control.companions.base import CompanionKind
from ehls_ros.families import Family

COMPANIONS: Family[CompanionKind] = Family("ehls_ros.control.companions", "companion", CompanionKind)
