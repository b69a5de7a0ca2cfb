"""The companions of one controller, called as one: each changes what the one before it left."""

from collections.abc import Mapping

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import Companion, Past, Upcoming
from ehls_ros.control.controllers.base import FORCE_ERROR, Model


class Company:
    """Companions in the order in which they were named.

    Attributes:
        members: companions by name.
    """

    def __init__(self, members: Mapping[str, Companion]) -> None:
        """Take companions by name."""
        self.members = members

    def __bool__(self) -> bool:
        """Tell whether there is any."""
        return bool(self.members)

    @property
    def corrects(self) -> bool:
        """Whether a companion hands the law another model of the rig."""
        return any(getattr(member, "corrects", False) for member in self.members.values())

    def prepare(self) -> None:
        """Compile, or load, all that the cycles need; nothing else changes."""
        for member in self.members.values():
            member.prepare()

    def room(self, first: int, place: Array) -> int:
        """Return how many of some cycles to come may run before :meth:`done` is called.

        Args:
            first: number of the first.
            place: place in the programme, shape (n, PLACE).
        """
        return min((member.room(first, place) for member in self.members.values()), default=len(place))

    def ahead(self, upcoming: Upcoming) -> None:
        """Change the rows of the cycles that will run next, in place."""
        for member in self.members.values():
            member.ahead(upcoming)

    def done(self, past: Past, model: Model) -> Model:
        """Take in what happened, and return the model that the law uses from now on.

        Args:
            past: the cycles; their status is changed in place: the force error is that to the reference wanted.
            model: the model in use.
        """
        past.status[:, FORCE_ERROR] += past.rows[:, 0] - past.wanted[:, 0]
        for member in self.members.values():
            model = member.done(past, model)
        return model

    def interrupt(self) -> None:
        """Tell all that what is half learnt does not count."""
        for member in self.members.values():
            member.interrupt()

    def at_bounds(self) -> tuple[str, ...]:
        """Return a sentence for each estimate of a companion that stands at its bound."""
        return tuple(sentence for member in self.members.values() for sentence in member.at_bounds())

    def report(self) -> dict[str, float | str]:
        """Return figures and sentences, each under its companion's name."""
        return {f"{name}.{key}": value for name, member in self.members.items() for key, value in member.report().items()}
