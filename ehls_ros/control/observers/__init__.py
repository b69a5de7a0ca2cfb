"""Friction observers, one file each; ``base`` says what a file provides."""

from ehls_ros.control.observers.base import FrictionObserver
from ehls_ros.families import Family

OBSERVERS: Family[FrictionObserver] = Family("ehls_ros.control.observers", "friction observer", FrictionObserver)
