"""Controllers, one file each; ``base`` defines the interface of a file."""

from ehls_ros.control.controllers.base import ControllerLaw
from ehls_ros.families import Family

CONTROLLERS: Family[ControllerLaw] = Family("ehls_ros.control.controllers", "controller", ControllerLaw)
