"""The two ways work ends early: a user's input was wrong, or the work itself failed."""


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
        self.what = what
        self.where = where
        self.expected = expected
        super().__init__(f"{where}: {what}; expected {expected}")

    def __reduce__(self) -> tuple[type["BadInput"], tuple[str, str, str]]:
        """Let it travel between processes."""
        return BadInput, (self.what, self.where, self.expected)


class WorkFailed(RuntimeError):
    """Work that could not be finished though its input was right: one line saying what happened and where to look.

    The command line prints it and exits with code 1.
    """
