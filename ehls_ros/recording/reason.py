"""What a library's exception says, short enough for one line of ours."""

from textwrap import shorten

LONGEST = 160


def reason(error: Exception) -> str:
    """Return the operating system's or the library's own words, on one line.

    Args:
        error: what was raised while a file was opened, read or written.
    """
    words = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return shorten(str(words), LONGEST, placeholder=" …")
