"""What every test gets: a ROS domain of its own, and a check that nothing of it stays behind."""

import contextlib
import fcntl
import itertools
import random
import signal
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import pytest

from ehls_ros.nodes.shared_memory import used_by

# DDS computes its ports from the domain; above domain 101 they reach into the range of ephemeral ports.
DOMAINS = range(1, 102)
FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250
# Every process started by a test inherits this variable, by which it is found again.
SESSION_VARIABLE = "EHLS_ROS_TEST_SESSION"
SHARED_MEMORY = Path("/dev/shm")
GRACE_S = 5.0

_rotation = itertools.cycle(random.sample(DOMAINS, len(DOMAINS)))


@pytest.fixture(scope="session")
def test_session() -> str:
    """Mark of the processes started by this run of pytest, or by this worker of it."""
    return uuid.uuid4().hex


@pytest.fixture(scope="session")
def domains_used() -> set[int]:
    """ROS domains of the tests run so far."""
    return set()


@pytest.fixture(scope="session", autouse=True)
def heard() -> None:
    """Let Ctrl-C reach what the tests start: a job that a script puts in the background inherits that SIGINT is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def nothing_left_behind(test_session: str, domains_used: set[int]) -> Iterator[None]:
    """Fail if, after the last test, a process started by a test runs on or files of a dead one are left in shared memory."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv(SESSION_VARIABLE, test_session)
        yield
    deadline = time.monotonic() + GRACE_S
    while (left := processes_of(test_session) + orphaned(domains_used)) and time.monotonic() < deadline:
        time.sleep(0.1)
    if left:
        pytest.fail("the tests left behind:\n  " + "\n  ".join(left), pytrace=False)


@pytest.fixture(autouse=True)
def ros_domain_id(monkeypatch: pytest.MonkeyPatch, domains_used: set[int]) -> Iterator[int]:
    """Give the test a ROS domain that no other test on this machine uses, and keep its discovery on this machine."""
    domain, lock = reserve_domain()
    with lock:
        domains_used.add(domain)
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield domain


def reserve_domain() -> tuple[int, TextIO]:
    """Lock a domain nobody has ports in.

    The domains are tried in turn, so that one just given back rests while late packets of its last test die away.

    Returns:
        The domain, and the open lock file: closing it, or the death of this process, gives the domain back.
    """
    deadline = time.monotonic() + 60.0
    for domain in _rotation:
        path = Path(tempfile.gettempdir(), f"ehls_ros_test_domain_{domain}.lock")
        # PermissionError: the lock file is another user's.
        with contextlib.suppress(BlockingIOError, PermissionError), contextlib.ExitStack() as undo:
            lock = undo.enter_context(path.open("a", encoding="utf-8"))
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not ports_of({domain}):
                undo.pop_all()
                return domain, lock
        if time.monotonic() > deadline:
            break
        time.sleep(0.01)
    pytest.fail("no ROS domain became free within a minute", pytrace=False)


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


def ports_of(domains: set[int]) -> dict[str, str]:
    """Return the files Fast DDS keeps in shared memory for the ports of the domains, each with its port."""
    ports = {}
    for path in SHARED_MEMORY.glob("fastrtps_port*"):
        port = path.name.removeprefix("fastrtps_port").removesuffix("_el")
        if port.isdigit() and (int(port) - FIRST_PORT) // PORTS_PER_DOMAIN in domains:
            ports[str(path)] = port
    return ports


def orphaned(domains: set[int]) -> list[str]:
    """Return a line for each file of a port of the domains that no living process holds.

    A process that shuts down removes them; one that is killed leaves them, and its segments beside them. Only the names of
    ports tell the domain, and so that the files are not those of somebody else's processes.
    """
    ports = ports_of(domains)
    for process in Path("/proc").glob("[0-9]*") if ports else ():
        with contextlib.suppress(OSError):
            held = {str(file) for file in used_by(int(process.name))}
            alive = {ports[name] for name in held & ports.keys()}
            ports = {name: port for name, port in ports.items() if port not in alive}
    return [f"{name} of a process that was killed instead of shut down" for name in sorted(ports)]
