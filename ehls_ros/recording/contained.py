"""Reading of files with libraries that trust their input, in a separate process with bounded memory and time.

A few kilobytes of a MAT, Parquet or Excel file can expand to terabytes, or be nested until the stack overflows. The libraries
allocate any size that a file states, and their calls cannot be interrupted; so the reading process ends instead of this one.
"""

import os
import pickle
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from ehls_ros.errors import BadInput, WorkFailed, reason
from ehls_ros.extras import missing
from ehls_ros.recording import limits
from ehls_ros.recording.limits import Deadline
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.sources import PACKAGE

Argument = TypeVar("Argument")

Result = TypeVar("Result")

SMALLER = "a file whose variables fit in memory, or the data as CSV"


def check_library(module: str, package: str, path: Path) -> None:
    """Reject a file whose library is not installed, without importing it, which would take as long as reading a file.

    Args:
        module: dotted name of the module that reads the format.
        package: name of the package to install.
        path: the file.

    Raises:
        BadInput: the library is not installed.
    """
    try:
        found = find_spec(module) is not None
    except (ImportError, ValueError):
        found = False
    if not found:
        raise missing(f"{package} is not installed, which reads this format", "files", str(path), "the data as CSV")


@contextmanager
def library_errors(kind: str, where: str, expected: str) -> Iterator[None]:
    """Convert a library's exceptions, which may be of any kind on a damaged file, to BadInput; MemoryError is passed on.

    Args:
        kind: kind of file, such as ``an Excel file``.
        where: the file.
        expected: description of a valid file.
    """
    try:
        yield
    except (BadInput, MemoryError):
        raise
    except Exception as error:  # noqa: BLE001 - each library has other exceptions
        raise BadInput(f"it is not {kind} ({reason(error)})", where, expected) from None


def contained(
    read: Callable[[Path, Argument], Result],
    path: Path,
    argument: Argument,
    expected: str,
    kind: type[Result],
    libraries: Sequence[str] = (),
) -> Result:
    """Read a file in a separate process.

    Args:
        read: the reader, a function at the top level of a module.
        path: the file.
        argument: further argument of the reader, picklable.
        expected: description of a valid file, for errors.
        kind: type of the result.
        libraries: modules imported by the reader; the limits do not count their memory and threads.

    Returns:
        The result of ``read``.

    Raises:
        BadInput: the file is rejected, takes too much memory or time for its size, or crashes the reader.
        WorkFailed: the process could not be started.
    """
    size = check_regular(path, limits.TABLE, expected, larger=limits.TABLE_LARGER)
    half = os.sysconf("SC_PHYS_PAGES") * resource.getpagesize() // 2
    memory = min(limits.COPIES * min(limits.EXPANDED + limits.EXPANSION * size, 8 * limits.VALUES), half)
    deadline = Deadline(size, str(path))
    done = _run_reader(pickle.dumps((read, path, argument, memory, deadline.seconds, libraries)), path, deadline)
    if done.returncode == -signal.SIGXCPU:
        raise deadline.error()
    if done.returncode or not done.stdout:
        name = signal.Signals(-done.returncode).name if done.returncode < 0 else f"exit code {done.returncode}"
        raise BadInput(f"it crashes the reading process ({name})", str(path), expected)
    result = pickle.loads(done.stdout)  # noqa: S301 - from our own process
    if isinstance(result, BadInput):
        raise result
    if isinstance(result, MemoryError):
        what = f"its {size} bytes take more than {memory >> 20} MB of memory"
        raise BadInput(what, str(path), SMALLER)
    assert isinstance(result, kind)  # noqa: S101 - _serve sends one of these three
    return result


def _run_reader(request: bytes, path: Path, deadline: Deadline) -> subprocess.CompletedProcess[bytes]:
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH")))),
        "ARROW_DEFAULT_MEMORY_POOL": "system",  # the other pools reserve more memory than they use
        "MALLOC_ARENA_MAX": "1",  # a second arena reserves 64 MB
        "OPENBLAS_NUM_THREADS": "1",
    }
    try:
        return subprocess.run(
            # Without -P a numpy.py in the current folder would be imported.
            [sys.executable, "-P", "-m", "ehls_ros.recording.contained"],
            input=request,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=deadline.seconds,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise deadline.error() from None
    except OSError as error:
        raise WorkFailed(f"{path}: the process to read it cannot be started ({error})") from None


def _serve() -> None:
    """Serve the request of the parent process."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries may print
    read, path, argument, memory, seconds, libraries = pickle.load(sys.stdin.buffer)  # noqa: S301 - from the parent process
    for library in libraries:
        import_module(library)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit(resource.RLIMIT_AS, pages * resource.getpagesize() + memory)
    limit(resource.RLIMIT_CPU, int(seconds) + 1)
    limit(resource.RLIMIT_CORE, 0)
    result: object
    try:
        result = read(path, argument)
        content = pickle.dumps(result, protocol=5)
    except BadInput as error:
        content = pickle.dumps(error)
    except MemoryError:
        content = pickle.dumps(MemoryError())
    with answer:
        answer.write(content)


def limit(kind: int, value: int) -> None:
    """Lower a resource limit of this process; an existing lower limit is kept."""
    soft, hard = resource.getrlimit(kind)
    known = [bound for bound in (value, soft, hard) if bound != resource.RLIM_INFINITY]
    resource.setrlimit(kind, (min(known), hard))


if __name__ == "__main__":
    _serve()
