"""Lets ``.venv/bin/python`` find the shared libraries of ehls_msgs when a ROS 2 installation is sourced.

``make setup`` copies this file into the environment, next to a ``.pth`` file that imports it when Python starts. ROS opens
the libraries of a message package by name, and the loader reads its search path only at start, so Python restarts itself.
"""

import os
import sys
from pathlib import Path


def main() -> None:
    """Put the environment first in the search paths of the loader and of ROS, unless it is there already."""
    library = str(Path(sys.prefix, "lib"))
    known = os.environ.get("LD_LIBRARY_PATH", "")
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "")
    if not prefixes or library in known.split(os.pathsep):
        return
    os.environ["LD_LIBRARY_PATH"] = os.pathsep.join(filter(None, [library, known]))
    os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join([sys.prefix, prefixes])
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606 - the interpreter itself


main()
