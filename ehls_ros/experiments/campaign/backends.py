"""Execution backends of a campaign: processes of this machine, or the workers of a Dask cluster.

Both take chunks of runs on demand, a few in advance, and return each chunk's rows once, as soon as it is done.
"""

import itertools
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, contextmanager
from importlib import import_module
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput, WorkFailed, reason
from ehls_ros.experiments.campaign.work import Row, code_version, run_chunk
from ehls_ros.extras import library, missing

CONNECTING_S, JOINING_S = 10.0, 60.0
"""Time limits for a scheduler to answer, and for its first worker to join [s]."""

MIN_JOBLIB = (1, 4)

AHEAD = 2
"""Number of chunks handed out per slot."""


class Chunk(NamedTuple):
    """A group of runs for one worker.

    Attributes:
        digests: key of each run.
        specs: spec of each run, as JSON.
        side_by_side: whether to run those that can in lanes of one call.
    """

    digests: tuple[str, ...]
    specs: tuple[str, ...]
    side_by_side: bool


Done = tuple[Chunk, list[Row]]


class Backend(NamedTuple):
    """An execution backend.

    Attributes:
        slots: number of chunks processed concurrently, as known at the start.
        work: function that processes chunks and yields each with its rows, in the order of completion.
        own_kernels: whether the kernels compiled for this process are certain to be available there.
    """

    slots: int
    work: Callable[[Iterator[Chunk]], Iterator[Done]]
    own_kernels: bool


Place = AbstractContextManager[Backend]
"""A backend as a context manager."""


@contextmanager
def local(jobs: int) -> Iterator[Backend]:
    """Run chunks in processes of this machine, each with one thread.

    Args:
        jobs: number of processes; with 1, the runs are made in this process.

    Raises:
        BadInput: joblib is not installed, or too old.
        WorkFailed: a process was killed.
    """
    joblib = _joblib()
    loky: Any = import_module("joblib.externals.loky.process_executor")
    processes: dict[str, Any] = {"inner_max_num_threads": 1, "initializer": _leave_interrupts_to_the_parent}
    with joblib.parallel_config("loky" if jobs > 1 else "sequential", **(processes if jobs > 1 else {})):
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch=AHEAD * jobs)

    def work(chunks: Iterator[Chunk]) -> Iterator[Done]:
        version = code_version()
        yield from parallel(joblib.delayed(_done)(chunk, version) for chunk in chunks)

    try:
        yield Backend(jobs, work, own_kernels=True)
    except loky.TerminatedWorkerError:
        raise WorkFailed(
            "a worker process was killed, perhaps for lack of memory; start the campaign again to continue"
        ) from None
    finally:
        if jobs > 1:
            joblib.externals.loky.get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)


def _joblib() -> Any:
    try:
        joblib: Any = import_module("joblib")
    except ImportError:
        found = "joblib is not installed"
    else:
        if tuple(map(int, joblib.__version__.split(".")[:2])) >= MIN_JOBLIB:
            return joblib
        found = f"joblib is {joblib.__version__}, which returns nothing before all is done"
    raise missing(found, "campaign", "campaign")


def _leave_interrupts_to_the_parent() -> None:
    # Ctrl-C reaches all processes; a worker interrupted while it returns a result would keep the queue locked.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _done(chunk: Chunk, version: str) -> Done:
    return chunk, run_chunk(chunk.specs, version, side_by_side=chunk.side_by_side)


@contextmanager
def dask(address: str) -> Iterator[Backend]:
    """Run chunks on a Dask cluster; those of a dead worker are repeated by others, and joining workers take part.

    Args:
        address: address of the scheduler, such as ``tcp://192.168.0.7:8786``.

    Raises:
        BadInput: ``distributed`` is not installed, or there is no such scheduler.
        WorkFailed: no worker joins, the cluster is lost, or its workers have other code.
    """
    distributed = library("distributed", "campaign", "--dask")
    try:
        client = distributed.Client(address, timeout=CONNECTING_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(f"{address} cannot be reached ({reason(error)})", "--dask", "a running scheduler's address") from None
    try:
        client.wait_for_workers(1, timeout=JOINING_S)
        yield Backend(_threads(client), lambda chunks: _on_cluster(distributed, client, chunks), own_kernels=False)
    except TimeoutError:
        raise WorkFailed(f"no worker joined within {JOINING_S:g} s; start one by: dask worker {address}") from None
    except distributed.KilledWorker as error:
        raise WorkFailed(f"workers died one after another over the same runs ({reason(error)})") from None
    except CancelledError:
        raise WorkFailed(f"the scheduler at {address} is lost; start the campaign again to continue") from None
    except ModuleNotFoundError as error:
        raise WorkFailed(f"a worker lacks the module {error.name}; install ehls_ros on every worker") from None
    finally:
        client.close()


def _on_cluster(distributed: Any, client: Any, chunks: Iterator[Chunk]) -> Iterator[Done]:
    version = code_version()
    futures = distributed.as_completed(loop=client.loop)
    under_way: dict[Any, Chunk] = {}
    while True:
        for chunk in itertools.islice(chunks, max(AHEAD * _threads(client) - len(under_way), 0)):
            future = client.submit(run_chunk, chunk.specs, version, side_by_side=chunk.side_by_side, pure=False)
            under_way[future] = chunk
            futures.add(future)
        if not under_way:
            return
        future = next(futures)
        yield under_way.pop(future), future.result()


def _threads(client: Any) -> int:
    return max(sum(int(threads) for threads in client.nthreads().values()), 1)
