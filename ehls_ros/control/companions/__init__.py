"""What works beside any controller, one file each; ``base`` says what a file provides."""

from ehls_ros.control.companions.base import CompanionKind
from ehls_ros.families import Family

COMPANIONS: Family[CompanionKind] = Family("ehls_ros.control.companions", "companion", CompanionKind)
