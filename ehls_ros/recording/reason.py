"""The message of a library's exception, shortened to one line."""

from textwrap import shorten

LONGEST = 160


def reason(error: Exception) -> str:
    """Return the message of the operating system or library, on one line.

    Args:
        error: exception raised while a file was opened, read or written.
    """
    words = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return shorten(str(words), LONGEST, placeholder=" …")
