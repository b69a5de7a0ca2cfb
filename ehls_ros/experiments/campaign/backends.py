"""Where runs are made: processes of this machine, or the workers of a Dask cluster.

Both take chunks of runs as they need them, a few ahead of the work, and give each chunk's rows back once, as it is done.
"""

import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.campaign.work import Row, code_version, run_chunk
from ehls_ros.extras import library
from ehls_ros.parallel import AHEAD, Workers
from ehls_ros.recording.reason import reason

CONNECTING_S, JOINING_S = 10.0, 60.0
"""Time limits for a scheduler to answer, and for its first worker to join [s]."""


class Chunk(NamedTuple):
    """Runs that a worker makes together.

    Attributes:
        digests: key of each.
        specs: spec of each, as JSON.
        side_by_side: whether those that can are made at once.
    """

    digests: tuple[str, ...]
    specs: tuple[str, ...]
    side_by_side: bool


Done = tuple[Chunk, list[Row]]


class Backend(NamedTuple):
    """A place to work in.

    Attributes:
        slots: chunks that are at work at once, as far as is known when the work begins.
        work: does chunks and gives each back with its rows, in the order they are done.
        own_kernels: whether it is certain to find the kernels that this process finds compiled.
    """

    slots: int
    work: Callable[[Iterator[Chunk]], Iterator[Done]]
    own_kernels: bool


Place = AbstractContextManager[Backend]
"""A backend as a context manager."""


@contextmanager
def local(jobs: int) -> Iterator[Backend]:
    """Work in processes of this machine, each with one thread.

    Args:
        jobs: processes; with 1 the work is done in this one.

    Raises:
        WorkFailed: a process was killed.
    """
    with Workers(jobs) as workers:

        def work(chunks: Iterator[Chunk]) -> Iterator[Done]:
            version = code_version()
            yield from workers.stream(partial(_done, chunk, version) for chunk in chunks)

        try:
            yield Backend(jobs, work, own_kernels=True)
        except BrokenProcessPool:
            raise WorkFailed("a worker process was killed, perhaps for want of memory; start again to go on") from None


def _done(chunk: Chunk, version: str) -> Done:
    return chunk, run_chunk(chunk.specs, version, side_by_side=chunk.side_by_side)


@contextmanager
def dask(address: str) -> Iterator[Backend]:
    """Work on a Dask cluster. The chunks of a worker that dies are done again by others; a worker that joins gets its share.

    Args:
        address: the scheduler's, such as ``tcp://192.168.0.7:8786``.

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
        raise WorkFailed(f"the scheduler at {address} is lost; start again to go on") from None
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
