"""What a verb's file provides: ``HELP``, ``arguments(parser)`` and ``run(options)``.

``run`` returns the exit code: 0 done, 1 the work failed. It raises ``BadInput`` for a user's mistake, which
the command turns into one line and exit code 2.
"""

from argparse import ArgumentParser, Namespace
from typing import Protocol


class Verb(Protocol):
    """The attributes of one verb's file."""

    HELP: str

    def arguments(self, parser: ArgumentParser) -> None:
        """Declare the verb's arguments."""

    def run(self, options: Namespace) -> int:
        """Do the work and return the exit code."""
