"""Standby controllers, and whether one could take over at once."""

import math

from ehls_ros.errors import BadInput


class Standby:
    """The controllers that have recently published standby commands.

    Attributes:
        cycle: the newest cycle.
    """

    def __init__(self, patience: int) -> None:
        """Start without controllers.

        Args:
            patience: cycles without an answer after which a controller no longer counts as standby.
        """
        self._patience = patience
        self._answered: dict[str, int] = {}
        self.cycle = -1

    def hear(self, sender: str, cycle: int) -> None:
        """Note a controller's standby command for a cycle."""
        self._answered[sender] = cycle

    def forget(self, sender: str) -> None:
        """Remove a controller that has left."""
        self._answered.pop(sender, None)

    @property
    def behind(self) -> list[str]:
        """Controllers that have not answered the newest cycle."""
        return [sender for sender in self.ready if self._answered.get(sender, -math.inf) < self.cycle]

    @property
    def ready(self) -> list[str]:
        """Controllers that could take over, sorted."""
        return sorted(sender for sender, cycle in self._answered.copy().items() if cycle >= self.cycle - self._patience)

    def named(self, name: str) -> str:
        """Return the sender of a controller.

        Args:
            name: its node, by full name or last part, or the sender itself.

        Raises:
            BadInput: no standby controller has this name, or several have.
        """
        ready = self.ready
        found = [sender for sender in ready if sender == name or is_of(sender, name)]
        if len(found) == 1:
            return found[0]
        expected = f"one of those that stand by: {', '.join(found or ready) or 'none'}"
        what = f"several controllers are named '{name}'" if found else f"'{name}' does not stand by"
        raise BadInput(what, "switch_controller", expected)


def is_of(sender: str, name: str) -> bool:
    """Return whether a sender, ``<full name of the node>-<process>``, belongs to a node, given its full name or last part."""
    node = sender.rpartition("-")[0]
    return bool(name) and (node == name or node.endswith(f"/{name.strip('/')}"))
