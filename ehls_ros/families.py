"""Families of interchangeable modules, one file each, identified by file name.

A member is a file in the family's folder, or a module that another distribution provides through an entry point::

    [project.entry-points."ehls_ros.controllers"]
    proportional = "acme_ehls.proportional"

The group is ``ehls_ros.`` and the plural of the family's noun; docs/how_to/package.md lists all groups.
"""

from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from inspect import isfunction
from pkgutil import iter_modules
from types import ModuleType
from typing import Any, Generic, TypeVar, cast

from ehls_ros.errors import BadInput, one_of

Member = TypeVar("Member")


@cache
def offered(group: str) -> EntryPoints:
    """Return the entry points of a group; cached, as reading all installed distributions takes 20 ms."""
    return entry_points(group=group)


class Family(Generic[Member]):
    """The members of one package: every module in it except ``base`` and those that start with ``_``.

    ``Member`` is the Protocol that each module satisfies.

    Attributes:
        package: dotted name of the package with the project's own members.
        noun: term for a member in errors, such as ``effect``.
        group: group of entry points for members of other distributions; the project's own names take precedence.
    """

    def __init__(self, package: str, noun: str, protocol: type) -> None:
        """Set the package, the noun for a member, and the Protocol that a member's file satisfies."""
        self.package = package
        self.noun = noun
        self.group = f"ehls_ros.{noun.lower().replace(' ', '_')}s"
        self._protocol = protocol
        self._loaded: dict[Any, Member] = {}

    def names(self) -> tuple[str, ...]:
        """Return the names of all members, sorted."""
        return tuple(sorted(self.own_names() | offered(self.group).names))

    def own_names(self) -> set[str]:
        """Return the names of the project's own members."""
        found = iter_modules(import_module(self.package).__path__)
        return {m.name for m in found if m.name != "base" and not m.name.startswith("_")}

    def load(self, name: Any, where: str = "configuration") -> Member:
        """Import a member.

        Args:
            name: file name without ``.py``, or name of the entry point.
            where: file and section, for the error.

        Raises:
            BadInput: there is no such member, or it is unusable.
        """
        # Listing the folder takes longer than most uses of a member.
        if isinstance(name, str) and name in self._loaded:
            return self._loaded[name]
        if isinstance(name, str) and name in self.own_names():
            member: Any = import_module(f"{self.package}.{name}")
        else:
            member = self._from_elsewhere(name, where)
        if missing := [attribute for attribute in self._required() if not hasattr(member, attribute)]:
            what = f"{self.noun} {name!r} has no {', '.join(missing)}"
            raise BadInput(what, where, f"everything that {self.package}.base requires, in {member.__file__}")
        self._loaded[name] = cast(Member, member)
        return self._loaded[name]

    def usable(self) -> dict[str, Member]:
        """Return all members that can be loaded, by name; broken ones are skipped."""
        members = {}
        for name in self.names():
            with suppress(BadInput):
                members[name] = self.load(name)
        return members

    def _from_elsewhere(self, name: Any, where: str) -> ModuleType:
        points = [point for point in offered(self.group) if point.name == name]
        if not points:
            raise BadInput(f"{self.noun} {name!r} is unknown", where, one_of(name, self.names()))
        if not str(name).isidentifier():
            raise BadInput(f"{self.noun} {name!r} of {_origin(points[0])}", where, "a name of letters, digits and underscores")
        if len(points) > 1:
            what = f"{self.noun} {name!r} is offered by {' and by '.join(map(_origin, points))}"
            raise BadInput(what, where, "only one of them installed")
        [point] = points
        try:
            member = point.load()
        except Exception as error:  # noqa: BLE001 - a foreign module may fail in any way
            what = f"{self.noun} {name!r} of {_origin(point)} cannot be imported ({type(error).__name__}: {error})"
            raise BadInput(what, where, f"{point.value} importable") from None
        if not isinstance(member, ModuleType):
            raise BadInput(f"{self.noun} {name!r} of {_origin(point)} is {point.value}", where, "the name of a module")
        return member

    def _required(self) -> list[str]:
        """Return the names that every member's file must define."""
        classes = [vars(c) for c in self._protocol.__mro__ if getattr(c, "_is_protocol", False)]
        declared = {name for own in classes for name in own.get("__annotations__", {})}
        functions = {name for own in classes for name, value in own.items() if isfunction(value)}
        return sorted(name for name in declared | functions if not name.startswith("_"))


def _origin(point: EntryPoint) -> str:
    """Return the distribution that provides an entry point."""
    return point.dist.name if point.dist else point.value
