"""Runtime checks of arguments, with readable errors for scripts and notebooks without a type checker."""

from numbers import Integral
from typing import Any

from ehls_ros.errors import BadInput


def check_kind(value: object, kinds: type | tuple[type, ...], name: str, expected: str) -> None:
    """Raise an error if a value has the wrong type.

    Args:
        value: the argument's value.
        kinds: the permitted types.
        name: of the argument, for the error.
        expected: description of a valid value, for the error.

    Raises:
        BadInput: the value has another type.
    """
    if not isinstance(value, kinds):
        raise BadInput(f"it is of the type {type(value).__name__}", name, expected)


def check_least(value: Any, least: int, name: str) -> None:
    """Raise an error unless a value is an integer of at least ``least`` or None, which selects the default.

    Raises:
        BadInput: it is less, or of another type.
    """
    if value is not None and not (isinstance(value, Integral) and int(value) >= least):
        raise BadInput(f"it is {value!r}", name, f"a whole number, {least} or more")
