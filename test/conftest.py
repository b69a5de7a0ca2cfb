"""Fixtures of every test: a separate ROS domain, and a check for leftover processes and files."""

import contextlib
import fcntl
import functools
import gc
import itertools
import math
import os
import random
import re
import signal
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import pytest
from patience import PATIENCE

from ehls_ros.nodes.shared_memory import leftovers

# DDS computes its ports from the domain; above domain 101 they reach into the range of ephemeral ports.
DOMAINS = range(1, 102)
FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250
# Every process started by a test inherits this variable, which identifies it.
SESSION_VARIABLE = "EHLS_ROS_TEST_SESSION"
SHARED_MEMORY = Path("/dev/shm")
GRACE_S = 60.0
# Lock files of this user: one for graphs in real time, and one for each run of the tests or worker of it.
REALTIME, UNDER_WAY = (Path(tempfile.gettempdir(), f"ehls_ros_test_{what}_{os.getuid()}.lock") for what in ("realtime", "run"))

# Folders, including this one, with tests that take seconds each; the scope of all whose graphs run in real time.
LONG = ("nodes", "dashboard", "diagnosis", "cli", "experiments", "reproduction", "report", "test")
IN_REALTIME = "graphs in real time"

# The tests start some hundred processes. Where the environment forbids keeping bytecode, each would compile its libraries anew,
# which takes longer than the rest of a node's start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# The workers share the cores: threads of the linear algebra library would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_rotation = itertools.cycle(random.sample(DOMAINS, len(DOMAINS)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each worker whole files, the slowest first; the short ones then fill the end.

    The files with graphs in real time go to one worker, one after another, as a second worker would wait for its turn.
    """
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class LongestFirst(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return IN_REALTIME if has_realtime_graph(config.rootpath / file) else file

        def _assign_work_unit(self, node: Any) -> None:
            # Files of one kind stay in the order of xdist, by the number of tests.
            first = min(self.workqueue, key=lambda scope: (scope != IN_REALTIME, Path(scope).parent.name not in LONG))
            self.workqueue.move_to_end(first, last=False)
            super()._assign_work_unit(node)

    return LongestFirst(config, log)


def pytest_collection_finish() -> None:
    """Exempt the collected tests and their modules from garbage collection: half a million permanent objects."""
    gc.collect()
    gc.freeze()


@functools.cache
def has_realtime_graph(file: Path) -> bool:
    """Return whether a test file takes turns with those of other workers."""
    return "one_realtime_graph" in file.read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def test_session() -> str:
    """Mark of the processes started by this run of pytest, or by this worker of it."""
    return uuid.uuid4().hex


@pytest.fixture(scope="session")
def domains_used() -> set[int]:
    """ROS domains reserved for several tests together; their leftovers are removed after the last test."""
    return set()


@pytest.fixture(scope="session", autouse=True)
def heard() -> None:
    """Let Ctrl-C reach the test processes: a script's background job inherits that SIGINT is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def nothing_left_behind(test_session: str, domains_used: set[int]) -> Iterator[None]:
    """Fail if a process started by a test still runs after the last test; remove the leftovers of killed ones."""
    began = time.time()
    with UNDER_WAY.open("a", encoding="utf-8") as under_way:
        fcntl.flock(under_way, fcntl.LOCK_SH)
        with pytest.MonkeyPatch.context() as environment:
            environment.setenv(SESSION_VARIABLE, test_session)
            yield
        deadline = time.monotonic() + GRACE_S
        while (left := processes_of(test_session)) and time.monotonic() < deadline:
            time.sleep(0.1)
        clear_orphans(domains_used, began)
        # The last run to end removes the leftovers common to all domains: another run may be about to use them.
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(under_way, fcntl.LOCK_EX | fcntl.LOCK_NB)
            clear_orphans(domains_used, began, of_all_domains=True)
    if left:
        pytest.fail("the tests left behind:\n  " + "\n  ".join(left), pytrace=False)


@pytest.fixture(autouse=True)
def ros_domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Give the test a ROS domain that no other test on this machine uses, and keep its discovery on this machine."""
    domain, lock = reserve_domain()
    with lock:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        began = time.time()
        yield domain
        if has_ports(domain):
            clear_orphans({domain}, began)


@contextlib.contextmanager
def realtime_turn() -> Iterator[None]:
    """Hold a reentrant lock that only one process at a time can hold, across all workers and runs of the tests."""
    if _has_turn.is_set():
        yield
        return
    with REALTIME.open("a", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _has_turn.set()
        try:
            yield
        finally:
            _has_turn.clear()


_has_turn = threading.Event()


@pytest.fixture
def one_realtime_graph() -> Iterator[None]:
    """Run a test's real-time graph without those of other workers, which would compete for the processors."""
    with realtime_turn():
        yield


@pytest.fixture(scope="module")
def one_realtime_graph_in_file() -> Iterator[None]:
    """Run a real-time graph shared by the tests of a file, without those of other workers."""
    with realtime_turn():
        yield


def reserve_domain() -> tuple[int, TextIO]:
    """Lock a domain whose ports are unused.

    The domains are tried in turn, so that a released one stays unused while late packets of its last test die away.

    Returns:
        The domain, and the open lock file: closing it, or the death of this process, releases the domain.
    """
    deadline = time.monotonic() + PATIENCE
    for domain in _rotation:
        path = Path(tempfile.gettempdir(), f"ehls_ros_test_domain_{domain}.lock")
        # PermissionError: the lock file is another user's.
        with contextlib.suppress(BlockingIOError, PermissionError), contextlib.ExitStack() as undo:
            lock = undo.enter_context(path.open("a", encoding="utf-8"))
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if has_ports(domain):
                clear_orphans({domain}, since=math.inf)
            if not has_ports(domain):
                undo.pop_all()
                return domain, lock
        if time.monotonic() > deadline:
            break
        time.sleep(0.01)
    pytest.fail(f"no ROS domain became free within {PATIENCE:.0f} s", pytrace=False)


def processes_of(session: str) -> list[str]:
    """Return a line for each running process that a test of the session started."""
    mark = f"{SESSION_VARIABLE}={session}".encode()
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
            # The helpers of multiprocessing live as long as the process that runs the tests.
            helper = "multiprocessing.resource_tracker" in command or "multiprocessing.forkserver" in command
            if mark in (process / "environ").read_bytes().split(b"\0") and command and not helper:
                found.append(f"process {process.name}: {command}")
    return found


def domain_of(file: Path) -> int | None:
    """Return the domain of a port's shared-memory file; None for a segment's file, whose name does not contain the domain.

    Ports below those of domain 0 belong to no domain: Fast DDS numbers all its participants on a machine there.
    """
    port = re.search(r"_port(\d+)", file.name)
    return (int(port[1]) - FIRST_PORT) // PORTS_PER_DOMAIN if port else None


def has_ports(domain: int) -> bool:
    """Return whether Fast DDS keeps files for ports of a domain."""
    return any(domain_of(path) == domain for path in SHARED_MEMORY.glob("*_port*"))


def clear_orphans(domains: set[int], since: float, *, of_all_domains: bool = False) -> None:
    """Remove shared-memory files left by killed processes and used by no living process.

    Args:
        domains: their ports are removed.
        since: segments made later are removed [s].
        of_all_domains: remove the other ports that were made later, too.
    """
    for path in leftovers():
        with contextlib.suppress(FileNotFoundError, PermissionError):
            domain = domain_of(path)
            new = path.stat().st_ctime >= since and (domain is None or of_all_domains)
            if new or domain in domains:
                path.unlink()
