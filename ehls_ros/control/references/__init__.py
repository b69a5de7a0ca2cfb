"""Reference signals, one file each; ``base`` defines the interface of a file."""

from ehls_ros.control.references.base import ReferenceSignal
from ehls_ros.families import Family

REFERENCES: Family[ReferenceSignal] = Family("ehls_ros.control.references", "reference", ReferenceSignal)
