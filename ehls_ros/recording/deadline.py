"""Time limit for reading a file."""

import time

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits


class Deadline:
    """Deadline for reading a file."""

    def __init__(self, size: int, where: str) -> None:
        """Start the clock.

        Args:
            size: size of the file [B].
            where: the file, for the error.
        """
        self.seconds = limits.SECONDS + size / limits.SLOWEST
        self._where = where
        self._end = time.monotonic() + self.seconds

    def passed(self) -> bool:
        """Return whether the deadline has passed."""
        return time.monotonic() > self._end

    def check(self) -> None:
        """Raise if the deadline has passed.

        Raises:
            BadInput: the deadline has passed.
        """
        if self.passed():
            raise self.error()

    def error(self) -> BadInput:
        """Return the error for a passed deadline."""
        return BadInput(f"reading it takes more than {self.seconds:.0f} s", self._where, "the recording in smaller files")
