"""Exceptions of the package: invalid input, and failure of the work itself."""

from collections.abc import Iterable
from difflib import get_close_matches
from textwrap import shorten

LONGEST = 1000
"""Maximum length of each part of a message [characters]; longer parts are cut in the middle."""

LONGEST_REASON = 160
"""Maximum length of a library's message within it [characters]."""


class BadInput(ValueError):
    """Invalid input, with a one-line message: the offending item, its place and the expected value.

    The command line prints it and exits with code 2.
    """

    def __init__(self, what: str, where: str, expected: str) -> None:
        """Compose the message.

        Args:
            what: the offending item and its value, such as ``moving_mass is -70``.
            where: its file, section and key.
            expected: description of acceptable values.
        """
        self.what = _readable(what)
        self.where = _readable(where)
        self.expected = _readable(expected)
        super().__init__(f"{self.where}: {self.what}; expected {self.expected}")

    def __reduce__(self) -> tuple[type["BadInput"], tuple[str, str, str]]:
        """Support pickling, for worker processes."""
        return BadInput, (self.what, self.where, self.expected)


def one_of(given: object, names: Iterable[str]) -> str:
    """List the accepted names, and suggest the one spelt most like a wrong name.

    Args:
        given: the wrong name.
        names: the names that are accepted.
    """
    known = list(names)
    similar = get_close_matches(str(given), known, n=1)
    return f"one of {', '.join(known)}{f'; did you mean {similar[0]!r}?' if similar else ''}" if known else "no such key"


def _readable(text: str) -> str:
    """Return a text, possibly quoted from a foreign file, as printable characters of limited length."""
    return _cut("".join(char if char.isprintable() else repr(char)[1:-1] for char in _cut(text)))


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST // 2 - 1]} … {text[-LONGEST // 2 + 2 :]}"


class WorkFailed(RuntimeError):
    """Failure of the work despite valid input, with a one-line message: the failure and where to look.

    The command line prints it and exits with code 1.
    """


def reason(error: Exception) -> str:
    """Return the message of the operating system or library, on one line.

    Args:
        error: exception raised while a file was opened, read or written.
    """
    words = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return shorten(str(words), LONGEST_REASON, placeholder=" …")
