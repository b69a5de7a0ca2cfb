"""A node that takes long to configure, in the process that runs it."""

import time
from pathlib import Path
from typing import Any

from ehls_ros.nodes.reference_node import ReferenceNode


def hold_up(until: str) -> None:
    """Delay the configuration of a reference node until a file exists."""
    prepare = ReferenceNode.prepare

    def prepare_late(node: Any) -> None:
        while not Path(until).exists():
            time.sleep(0.01)
        prepare(node)

    setattr(ReferenceNode, "prepare", prepare_late)  # noqa: B010
