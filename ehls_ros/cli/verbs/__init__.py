"""The verbs of `ehls`, one file each; ``base`` defines the interface of a file."""

from ehls_ros.cli.verbs.base import Verb
from ehls_ros.families import Family

VERBS: Family[Verb] = Family("ehls_ros.cli.verbs", "verb", Verb)
