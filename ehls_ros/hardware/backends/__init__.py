"""DAQ backends, one file each; ``base`` says what a file provides.

A distribution of somebody else's adds one by an entry point of the group ``ehls_ros.daq_backends`` that names its module.
"""

from ehls_ros.families import Family
from ehls_ros.hardware.backends.base import Backend

BACKENDS: Family[Backend] = Family("ehls_ros.hardware.backends", "DAQ backend", "ehls_ros.daq_backends")
