"""Ending a process that has used the middleware."""

import os
import sys
from typing import NoReturn


def end(code: int) -> NoReturn:
    """End this process now, with everything it printed.

    Fast DDS tears its static objects down after Python has gone, against threads of its own that still run; about one
    exit in thirty then hangs or crashes, long after the work is done. Whoever has closed what it opened skips that.

    Args:
        code: exit code.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
