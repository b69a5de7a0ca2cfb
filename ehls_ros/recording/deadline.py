"""The time a reader has for a file."""

import time

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits


class Deadline:
    """When reading has to be done."""

    def __init__(self, size: int, where: str) -> None:
        """Begin to count.

        Args:
            size: of what is read [B].
            where: the file, for the error.
        """
        self.seconds = limits.SECONDS + size / limits.SLOWEST
        self._where = where
        self._end = time.monotonic() + self.seconds

    def passed(self) -> bool:
        """Tell whether the time is over."""
        return time.monotonic() > self._end

    def check(self) -> None:
        """Give up when the time is over.

        Raises:
            BadInput: it is.
        """
        if self.passed():
            raise self.error()

    def error(self) -> BadInput:
        """Return what is said then."""
        return BadInput(f"reading it takes more than {self.seconds:.0f} s", self._where, "the recording in smaller files")
