"""Chain the companions of one controller: each processes the output of the previous one."""

from collections.abc import Mapping

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import Companion, Past, Upcoming
from ehls_ros.control.controllers.base import FORCE_ERROR, Model


class CompanionChain:
    """Companions in the order in which they were named.

    Attributes:
        members: companions by name.
    """

    def __init__(self, members: Mapping[str, Companion]) -> None:
        """Store the companions by name."""
        self.members = members

    def __bool__(self) -> bool:
        """Return whether there is any companion."""
        return bool(self.members)

    @property
    def corrects(self) -> bool:
        """Whether a companion hands the law another model of the rig."""
        return any(getattr(member, "corrects", False) for member in self.members.values())

    def prepare(self) -> None:
        """Compile or load all code that the cycles need; change no state."""
        for member in self.members.values():
            member.prepare()

    def room(self, first: int, place: Array) -> int:
        """Return the number of upcoming cycles that may run before :meth:`done` is called.

        Args:
            first: number of the first cycle.
            place: place in the programme, shape (n, PLACE).
        """
        return min((member.room(first, place) for member in self.members.values()), default=len(place))

    def ahead(self, upcoming: Upcoming) -> None:
        """Change the rows of the cycles that will run next, in place."""
        for member in self.members.values():
            member.ahead(upcoming)

    def done(self, past: Past, model: Model) -> Model:
        """Process the record of past cycles, and return the model for the law from now on.

        Args:
            past: the cycles. Their status is changed in place: its force error becomes that to the wanted reference.
            model: the model in use.
        """
        past.status[:, FORCE_ERROR] += past.rows[:, 0] - past.wanted[:, 0]
        for member in self.members.values():
            model = member.done(past, model)
        return model

    def interrupt(self) -> None:
        """Discard incomplete learning in all companions."""
        for member in self.members.values():
            member.interrupt()

    def at_bounds(self) -> tuple[str, ...]:
        """Return a sentence for each companion's estimate at its bound."""
        return tuple(sentence for member in self.members.values() for sentence in member.at_bounds())

    def report(self) -> dict[str, float | str]:
        """Return figures and sentences, with the companion's name as prefix."""
        return {f"{name}.{key}": value for name, member in self.members.items() for key, value in member.report().items()}
