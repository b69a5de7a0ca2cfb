"""Arguments that no type checker has seen: refused in words, as scripts and notebooks need it."""

from numbers import Integral
from typing import Any

from ehls_ros.errors import BadInput


def check_kind(value: object, kinds: type | tuple[type, ...], name: str, expected: str) -> None:
    """Refuse a value of another kind.

    Args:
        value: what was given.
        kinds: the classes of which it has to be one.
        name: of the argument, for the error.
        expected: what it has to be, for the error.

    Raises:
        BadInput: it is of another kind.
    """
    if not isinstance(value, kinds):
        raise BadInput(f"it is of the type {type(value).__name__}", name, expected)


def check_least(value: Any, least: int, name: str) -> None:
    """Refuse what is no whole number of at least ``least``; None stands for the usual one.

    Raises:
        BadInput: it is less, or of another kind.
    """
    if value is not None and not (isinstance(value, Integral) and int(value) >= least):
        raise BadInput(f"it is {value!r}", name, f"a whole number, {least} or more")
