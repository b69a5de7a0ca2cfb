"""Reading by libraries that trust what they read, in a process of its own whose memory and time are bounded.

A few kilobytes of a MAT or Parquet file can stand for terabytes, or be nested until the stack overflows. The libraries allocate
what they are told to, and what is within a call of theirs cannot be interrupted. So the process ends, and not ours.
"""

import os
import pickle
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.recording import limits
from ehls_ros.recording.columns import Columns
from ehls_ros.recording.deadline import Deadline
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.sources import PACKAGE
from ehls_ros.trajectory import Trajectory

Read = Callable[[Path, Columns], Trajectory]

SMALLER = "a file whose variables fit into memory, or the data as CSV"


def contained(read: Read, path: Path, columns: Columns, expected: str) -> Trajectory:
    """Read a file elsewhere.

    Args:
        read: what reads it; a function at the top level of a module.
        path: the file.
        columns: the user's own names and units.
        expected: what the file should be, for errors.

    Returns:
        What was read.

    Raises:
        BadInput: the file is refused, or takes more memory or time than one of its size may, or the reader dies of it.
        WorkFailed: the process could not be started.
    """
    size = check_regular(path, limits.TABLE, expected, larger=limits.TABLE_LARGER)
    half = os.sysconf("SC_PHYS_PAGES") * resource.getpagesize() // 2
    memory = min(limits.COPIES * min(limits.EXPANDED + limits.EXPANSION * size, 8 * limits.VALUES), half)
    deadline = Deadline(size, str(path))
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH")))),
        "ARROW_DEFAULT_MEMORY_POOL": "system",  # the others reserve more than they use
        "OPENBLAS_NUM_THREADS": "1",
    }
    try:
        done = subprocess.run(
            # Without -P a numpy.py in the current folder would be imported.
            [sys.executable, "-P", "-m", "ehls_ros.recording.contained"],
            input=pickle.dumps((read, path, columns, memory, deadline.seconds)),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=deadline.seconds,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise deadline.error() from None
    except OSError as error:
        raise WorkFailed(f"{path}: no process can be started to read it ({error})") from None
    if done.returncode == -signal.SIGXCPU:
        raise deadline.error()
    if done.returncode or not done.stdout:
        name = signal.Signals(-done.returncode).name if done.returncode < 0 else f"exit code {done.returncode}"
        raise BadInput(f"what reads it dies of it ({name})", str(path), expected)
    result = pickle.loads(done.stdout)  # noqa: S301 - from a process of ours
    if isinstance(result, BadInput):
        raise result
    if isinstance(result, MemoryError):
        what = f"its {size} bytes take more than {memory >> 20} MB of memory"
        raise BadInput(what, str(path), SMALLER)
    assert isinstance(result, Trajectory)  # noqa: S101 - the three things _serve sends
    return result


def _serve() -> None:
    """Read what the process that started this one asks for."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints
    read, path, columns, memory, seconds = pickle.load(sys.stdin.buffer)  # noqa: S301 - from the process that started this one
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit(resource.RLIMIT_AS, pages * resource.getpagesize() + memory)
    limit(resource.RLIMIT_CPU, int(seconds) + 1)
    limit(resource.RLIMIT_CORE, 0)
    result: object
    try:
        result = read(path, columns)
        content = pickle.dumps(result, protocol=5)
    except BadInput as error:
        content = pickle.dumps(error)
    except MemoryError:
        content = pickle.dumps(MemoryError())
    with answer:
        answer.write(content)


def limit(kind: int, value: int) -> None:
    """Lower a limit of this process; one that is lower already stays."""
    soft, hard = resource.getrlimit(kind)
    known = [bound for bound in (value, soft, hard) if bound != resource.RLIM_INFINITY]
    resource.setrlimit(kind, (min(known), hard))


if __name__ == "__main__":
    _serve()
