"""Physical effects beyond the paper's model, one file each; ``base`` defines the interface of a file."""

from ehls_ros.families import Family
from ehls_ros.physics.effects.base import Effect

EFFECTS: Family[Effect] = Family("ehls_ros.physics.effects", "effect", Effect)
