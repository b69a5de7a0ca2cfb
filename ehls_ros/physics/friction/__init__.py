"""Friction models, one file each; ``base`` defines the interface of a model."""

from ehls_ros.families import Family
from ehls_ros.physics.friction.base import FrictionModel

FRICTION_MODELS: Family[FrictionModel] = Family("ehls_ros.physics.friction", "friction model", FrictionModel)
