"""Arguments that no type checker has seen: refused in words, as scripts and notebooks need it."""

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


def check_least(value: int | None, least: int, name: str) -> None:
    """Refuse a number that is too small; None stands for the usual one.

    Raises:
        BadInput: it is less than ``least``.
    """
    if value is not None and value < least:
        raise BadInput(f"it is {value}", name, f"{least} or more")
