"""What every test gets: a ROS domain of its own, and a check that nothing of it stays behind."""

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
# Every process started by a test inherits this variable, by which it is found again.
SESSION_VARIABLE = "EHLS_ROS_TEST_SESSION"
SHARED_MEMORY = Path("/dev/shm")
GRACE_S = 60.0
# Lock files of this user's: one has its graph run in real time; each run of the tests, or worker of it, is under way.
REALTIME, UNDER_WAY = (Path(tempfile.gettempdir(), f"ehls_ros_test_{what}_{os.getuid()}.lock") for what in ("realtime", "run"))

# Folders, and this one, with tests that take seconds each; the scope of all whose graphs run in real time.
LONG = ("nodes", "dashboard", "diagnosis", "cli", "experiments", "report", "test")
IN_REALTIME = "graphs in real time"

# The tests start some hundred processes. Where the environment forbids to keep bytecode, each would compile its libraries anew,
# which takes longer than all else in the start of a node.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

_rotation = itertools.cycle(random.sample(DOMAINS, len(DOMAINS)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each worker whole files, those that take longest first; the short ones then fill the end.

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
    """Let the garbage collector pass over the collected tests and their modules: half a million objects that stay."""
    gc.collect()
    gc.freeze()


@functools.cache
def has_realtime_graph(file: Path) -> bool:
    """Tell whether a file of tests takes turns with those of other workers."""
    return "one_realtime_graph" in file.read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def test_session() -> str:
    """Mark of the processes started by this run of pytest, or by this worker of it."""
    return uuid.uuid4().hex


@pytest.fixture(scope="session")
def domains_used() -> set[int]:
    """ROS domains reserved for several tests together: what is left in them is cleared away after the last test."""
    return set()


@pytest.fixture(scope="session", autouse=True)
def heard() -> None:
    """Let Ctrl-C reach what the tests start: a job that a script puts in the background inherits that SIGINT is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def nothing_left_behind(test_session: str, domains_used: set[int]) -> Iterator[None]:
    """Fail if, after the last test, a process started by a test runs on; clear away what those that were killed left."""
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
        # The last one to end clears away what all domains have in common: somebody else may be about to use it.
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
    """Hold a lock that one process at a time has, whichever worker or run of the tests it is; a process may take it again."""
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
    """Run a test's graph in real time without those of other workers, which would take the processors from it."""
    with realtime_turn():
        yield


@pytest.fixture(scope="module")
def one_realtime_graph_in_file() -> Iterator[None]:
    """Do the same for a graph that the tests of a file share."""
    with realtime_turn():
        yield


def reserve_domain() -> tuple[int, TextIO]:
    """Lock a domain nobody has ports in.

    The domains are tried in turn, so that one just given back rests while late packets of its last test die away.

    Returns:
        The domain, and the open lock file: closing it, or the death of this process, gives the domain back.
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
    """Return a line for each process started by a test of the session that still runs."""
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
    """Return the domain of a port whose file in shared memory this is; None where it is a segment's, whose name does not say.

    Ports below those of domain 0 are of no domain: Fast DDS numbers all its participants on a machine there.
    """
    port = re.search(r"_port(\d+)", file.name)
    return (int(port[1]) - FIRST_PORT) // PORTS_PER_DOMAIN if port else None


def has_ports(domain: int) -> bool:
    """Tell whether Fast DDS keeps files for ports of a domain."""
    return any(domain_of(path) == domain for path in SHARED_MEMORY.glob("*_port*"))


def clear_orphans(domains: set[int], since: float, *, of_all_domains: bool = False) -> None:
    """Remove what killed processes left in shared memory, as long as no living process uses it.

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
