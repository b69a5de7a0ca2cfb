"""Families of interchangeable parts: one file each, found by its file name."""

from importlib import import_module
from pkgutil import iter_modules
from typing import Any, Generic, TypeVar, cast

from ehls_ros.errors import BadInput

Member = TypeVar("Member")


class Family(Generic[Member]):
    """The members of one package: every module in it but ``base`` and those that start with ``_``.

    ``Member`` is the Protocol that each module satisfies; the package's contract test checks it.
    """

    def __init__(self, package: str, noun: str) -> None:
        """Name the package.

        Args:
            package: dotted name of the package that holds the members.
            noun: what one member is called in errors, such as ``effect``.
        """
        self.package = package
        self.noun = noun
        self._loaded: dict[Any, Member] = {}

    def names(self) -> tuple[str, ...]:
        """Return the names of all members, sorted."""
        found = iter_modules(import_module(self.package).__path__)
        return tuple(sorted(m.name for m in found if m.name != "base" and not m.name.startswith("_")))

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
        member = cast(Member, import_module(f"{self.package}.{name}"))
        self._loaded[name] = member
        return member
