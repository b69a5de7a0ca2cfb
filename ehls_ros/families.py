"""Families of interchangeable parts: one file each, found by its file name."""

from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules
from typing import Any, Generic, TypeVar, cast

from ehls_ros.errors import BadInput

Member = TypeVar("Member")


class Family(Generic[Member]):
    """The members of one package: every module in it but ``base`` and those that start with ``_``.

    ``Member`` is the Protocol that each module satisfies; the package's contract test checks it.
    """

    def __init__(self, package: str, noun: str, group: str | None = None) -> None:
        """Name the package.

        Args:
            package: dotted name of the package that holds the members.
            noun: what one member is called in errors, such as ``effect``.
            group: group of entry points by which other distributions add members; a name of the package's own wins.
        """
        self.package = package
        self.noun = noun
        self.group = group
        self._loaded: dict[Any, Member] = {}

    def names(self) -> tuple[str, ...]:
        """Return the names of all members, sorted."""
        return tuple(sorted(self._own() | self._installed().keys()))

    def load(self, name: Any, where: str = "configuration") -> Member:
        """Import a member.

        Args:
            name: file name without ``.py``, as a configuration gives it.
            where: file and section, for the error.

        Raises:
            BadInput: there is no such member.
        """
        # Listing the folder takes longer than most of what a member is asked for.
        if isinstance(name, str) and name in self._loaded:
            return self._loaded[name]
        if name not in self.names():
            raise BadInput(f"{self.noun} {name!r} is unknown", where, f"one of {', '.join(self.names())}")
        own = name in self._own()
        member = cast(Member, import_module(f"{self.package}.{name}") if own else self._from_elsewhere(name, where))
        self._loaded[name] = member
        return member

    def _own(self) -> set[str]:
        found = iter_modules(import_module(self.package).__path__)
        return {m.name for m in found if m.name != "base" and not m.name.startswith("_")}

    def _installed(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=self.group)} if self.group else {}

    def _from_elsewhere(self, name: str, where: str) -> Any:
        point = self._installed()[name]
        try:
            return point.load()
        except (ImportError, AttributeError) as error:
            raise BadInput(f"{self.noun} {name!r} cannot be imported ({error})", where, f"{point.value} as installed") from None
