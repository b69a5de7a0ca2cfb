"""The two ways work ends early: a user's input was wrong, or the work itself failed."""

LONGEST = 1000
"""Characters of each part of a line; what is longer is cut in the middle."""


class BadInput(ValueError):
    """A user's input that cannot be used: one line saying what, where and what was expected.

    The command line prints it and exits with code 2.
    """

    def __init__(self, what: str, where: str, expected: str) -> None:
        """Make the one line.

        Args:
            what: the offending thing with its value, such as ``moving_mass is -70``.
            where: file, section and key it stands in.
            expected: what would have been accepted.
        """
        self.what = _readable(what)
        self.where = _readable(where)
        self.expected = _readable(expected)
        super().__init__(f"{self.where}: {self.what}; expected {self.expected}")

    def __reduce__(self) -> tuple[type["BadInput"], tuple[str, str, str]]:
        """Let it travel between processes."""
        return BadInput, (self.what, self.where, self.expected)


def _readable(text: str) -> str:
    """Return a text, parts of which may come out of a foreign file, such that it neither breaks the line nor floods it."""
    return _cut("".join(char if char.isprintable() else repr(char)[1:-1] for char in _cut(text)))


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST // 2 - 1]} … {text[-LONGEST // 2 + 2 :]}"


class WorkFailed(RuntimeError):
    """Work that could not be finished though its input was right: one line saying what happened and where to look.

    The command line prints it and exits with code 1.
    """
