"""Search of large files in pieces, as Python handles no signals during a regular expression search."""

import re
from mmap import mmap

PIECE = 1 << 20
"""Bytes searched in one call."""


def first_match(
    pattern: re.Pattern[bytes], content: bytes | mmap, start: int, end: int, longest: int
) -> re.Match[bytes] | None:
    """Return the first match of a pattern, searching in pieces so that Ctrl-C is handled.

    Args:
        pattern: the pattern.
        content: content of the file.
        start: offset to begin at.
        end: offset behind the last byte that may belong to the match.
        longest: length of the longest match.
    """
    for begin in range(start, end, PIECE):
        match = pattern.search(content, begin, min(begin + PIECE + longest, end))
        if match is not None:
            return match
    return None
