"""Interface of a verb's file: ``HELP``, ``arguments(parser)`` and ``run(options)``.

``run`` returns the exit code: 0 done, 1 the work failed. It raises ``BadInput`` for a user's mistake; the command
prints it as one line and exits with code 2.
"""

from argparse import ArgumentParser, Namespace
from typing import Protocol


class Verb(Protocol):
    """Interface of a verb's file."""

    HELP: str

    def arguments(self, parser: ArgumentParser) -> None:
        """Declare the verb's arguments."""

    def run(self, options: Namespace) -> int:
        """Do the work and return the exit code."""
