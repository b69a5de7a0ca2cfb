"""Time limit for reading a file."""

import time

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits


class Deadline:
    """The time by which a file must be read."""

    def __init__(self, size: int, where: str) -> None:
        """Start the clock.

        Args:
            size: of the file [B].
            where: the file, for the error.
        """
        self.seconds = limits.SECONDS + size / limits.SLOWEST
        self._where = where
        self._end = time.monotonic() + self.seconds

    def passed(self) -> bool:
        """Tell whether the time is over."""
        return time.monotonic() > self._end

    def check(self) -> None:
        """Raise if the time is over.

        Raises:
            BadInput: the time is over.
        """
        if self.passed():
            raise self.error()

    def error(self) -> BadInput:
        """Return the error for an expired time."""
        return BadInput(f"reading it takes more than {self.seconds:.0f} s", self._where, "the recording in smaller files")
