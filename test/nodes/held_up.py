"""A node that takes long to configure itself, in the process that runs it."""

import time
from pathlib import Path
from typing import Any

from ehls_ros.nodes.reference_node import ReferenceNode


def hold_up(until: str) -> None:
    """Let a reference node configure itself only once a file is there."""
    prepare = ReferenceNode.prepare

    def prepare_late(node: Any) -> None:
        while not Path(until).exists():
            time.sleep(0.01)
        prepare(node)

    setattr(ReferenceNode, "prepare", prepare_late)  # noqa: B010
