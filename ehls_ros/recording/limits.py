"""Limits of all readers, and the deadline that follows from them.

Recordings of a rig stay far below them; files above them are rejected before they cost memory or time. An hour of ten columns
at 1 kHz has 3.6e7 values and takes 0.7 GB as CSV.
"""

import time

from ehls_ros.errors import BadInput

TEXT = 4 * 2**20
"""Longest YAML file, bag metadata or reference file [characters]; a load spectrum of 10^5 points is shorter."""

YAML_DEPTH = 50
"""Deepest nesting of collections [1]; a spec has six levels."""

YAML_NUMBER = 400
"""Longest number [characters]; the largest float has 309 digits."""

TABLE = 8 * 2**30
"""Largest CSV, MAT or Parquet file [B]."""

TABLE_LARGER = ": split it by time, or write it as Parquet"

LINE = 2**18
"""Longest line of a CSV file [characters]; a thousand columns take a tenth."""

ROWS = 20_000_000
"""Maximum number of samples of a recording: 5.5 h at 1 kHz [1]."""

VALUES = 200_000_000
"""Maximum number of values of a table, rows times columns: an hour of all signals at 1 kHz [1]."""

BAG = 64 * 2**30
"""Largest bag [B]; an hour recorded by this package takes 4 GB."""

BAG_LARGER = ": `ros2 bag convert` splits it"

TOPICS = 4096
"""Maximum number of topics of a bag [1]."""

MESSAGE = 2**16
"""Largest message of a topic that is read [B]; those of this package have some hundred bytes."""

GATHERED = 2**26
"""Total size of messages decoded together [B]."""

LAYOUTS = 64
"""Maximum number of layouts, by lengths of strings and sequences, among messages decoded together [1]; one or two are usual."""

SUMMARY = 2**26
"""Largest summary of an mcap file and largest record other than a chunk [B]; a bag of 4 GB has 3 MB."""

CHUNK = 2**26
"""Largest chunk of an mcap file, compressed or not [B]; recorders write 1 to 4 MB."""

CHUNKS_AT_ONCE = 2**28
"""Largest total size of chunks that overlap in time and so are in memory together [B]."""

EXPANSION = 100
"""Largest compression ratio [1]; a run compresses two- to fivefold, one at rest elevenfold."""

EXPANDED = 2**26
"""Size to which any file may expand, whatever its ratio [B]."""

COPIES = 4
"""Number of copies of an expanded MAT or Parquet file that a library may hold [1]."""

SECONDS = 60.0
"""Reading time allowed for any file [s]."""

MIN_RATE = 1e6
"""Slowest reading rate of a larger file [B/s]; even a busy computer is ten times as fast."""


class Deadline:
    """Deadline for reading a file."""

    def __init__(self, size: int, where: str) -> None:
        """Start the clock.

        Args:
            size: size of the file [B].
            where: the file, for the error.
        """
        self.seconds = SECONDS + size / MIN_RATE
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
