"""Optimisers of sums of squares, one file each; ``base`` specifies the interface of a file."""

from ehls_ros.families import Family
from ehls_ros.identification.optimisers.base import Optimiser

OPTIMISERS: Family[Optimiser] = Family("ehls_ros.identification.optimisers", "optimiser", Optimiser)
