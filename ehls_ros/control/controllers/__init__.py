"""Controllers, one file each; ``base`` says what a file provides."""

from ehls_ros.control.controllers.base import ControllerLaw
from ehls_ros.families import Family

CONTROLLERS: Family[ControllerLaw] = Family("ehls_ros.control.controllers", "controller", ControllerLaw)
