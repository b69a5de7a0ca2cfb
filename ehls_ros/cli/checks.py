"""Checks of `ehls doctor`, one function each, that return a finding and advice."""

import importlib
import importlib.metadata
import os
import platform
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import config_folder
from ehls_ros.hardware.realtime import sleep_until
from ehls_ros.nodes.shared_memory import leftovers, used_by
from ehls_ros.physics.kernel_cache import cache_folder

Level = Literal["ok", "note", "problem"]

SUPPORTED = ((3, 11), (3, 13))
"""First and last Python version tested."""

WAKE_UPS = 500
PERIOD = 1e-3

DISCOVERY_TIME = 20.0
"""Longest time for two processes to discover each other [s]."""

STARTING, ENDING = 20.0, 10.0
"""Further time for a process to start, and time for it to exit [s]."""

MIN_SPACE = 4.0
"""Disk space for about an hour of recording at 1 kHz [GB]."""

MAX_LATENCY = 500.0
"""Maximum wake-up latency for a 1 ms period [us]."""

LOCKED_MEMORY = 2**29
"""Memory that a realtime node may lock, with margin [B]: 200 MiB, and 70 MiB more while it compiles its kernels."""

CPU = Path("/sys/devices/system/cpu")

ROUND_TRIP = (sys.executable, "-m", "ehls_ros.nodes.round_trip")
"""Command of the two processes that exchange messages."""


class Finding(NamedTuple):
    """Result of a check.

    Attributes:
        check: its name.
        level: ok; note: worth knowing; problem: something will not work.
        found: finding, one line.
        advice: recommended action; empty if none.
    """

    check: str
    level: Level
    found: str
    advice: str = ""


def python() -> Finding:
    """Check the interpreter's version."""
    found = f"{platform.python_version()} at {sys.executable}"
    if SUPPORTED[0] <= sys.version_info[:2] <= SUPPORTED[1]:
        return Finding("Python", "ok", found)
    return Finding("Python", "problem", found, "use CPython 3.11, 3.12 or 3.13: PYTHON=python3.12 make setup")


def packages() -> Finding:
    """Check that the required packages can be imported, and the optional plotly and shtab."""
    if missing := _not_importable("numba", "numpy", "rich", "rosbags", "scipy", "yaml"):
        advice = "make setup, or pip install . again; in a ROS workspace, rosdep install"
        return Finding("packages", "problem", f"cannot be imported: {missing}", advice)
    if missing := _not_importable("plotly", "shtab"):
        advice = "pip install plotly shtab, for figures in reports and completion in the shell"
        return Finding("packages", "note", f"cannot be imported: {missing}", advice)
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("numpy", "numba", "rosbags"))
    # Only here is numba known to be there.
    inlining = importlib.import_module("ehls_ros.inlining")
    if reason := inlining.reason_for_plain_numba():
        found = f"{versions}; kernels compile at half the speed, by plain numba: {reason}"
        return Finding("packages", "note", found, f"pip install 'numba{inlining.TESTED}'")
    return Finding("packages", "ok", versions)


def _not_importable(*names: str) -> str:
    """Return the packages that cannot be imported, each with the reason."""
    missing = []
    for name in names:
        try:
            importlib.import_module(name)
        except ImportError as error:
            missing.append(f"{name} ({error})")
    return ", ".join(missing)


def ros() -> Finding:
    """Check that ROS and the messages can be imported."""
    try:
        importlib.import_module("rclpy")
    except ImportError as error:
        advice = "source ROS 2 Jazzy, or make setup for the wheels; without it: ehls experiment --in-process"
        return Finding("ROS 2", "note", f"rclpy cannot be imported ({error})", advice)
    try:
        importlib.import_module("ehls_msgs.msg")
    except ImportError as error:
        return Finding(
            "ROS 2", "problem", f"ehls_msgs cannot be imported ({error})", "make setup, or colcon build and source it"
        )
    distribution = os.environ.get("ROS_DISTRO", "wheels")
    middleware = os.environ.get("RMW_IMPLEMENTATION", "the default")
    return Finding("ROS 2", "ok", f"{distribution}, middleware {middleware}")


def environment() -> Finding:
    """Check the environment variables of discovery."""
    domain = os.environ.get("ROS_DOMAIN_ID", "not set: 0, or a free one for `ehls experiment`")
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "not set: this host only")
    found = f"domain {domain}; discovery range {reach}"
    if reach == "SUBNET":
        return Finding(
            "discovery range", "note", found, "the nodes are visible to the entire subnet: LOCALHOST keeps them on this host"
        )
    return Finding("discovery range", "ok", found)


def discovery() -> Finding:
    """Check that two processes discover each other, and measure a message's round trip."""
    try:
        from ehls_ros.nodes.graph import graph_environment
    except ImportError:
        return Finding("DDS", "note", "not checked without ROS 2")
    environment = graph_environment()
    pipe = subprocess.PIPE
    echo = subprocess.Popen([*ROUND_TRIP, "answer"], env=environment, stderr=subprocess.DEVNULL, text=True)
    asking = [*ROUND_TRIP, "ask", str(DISCOVERY_TIME)]
    asker = subprocess.Popen(asking, env=environment, stdout=pipe, stderr=pipe, text=True)
    try:
        found, complaints = _output(asker, DISCOVERY_TIME + STARTING)
    finally:
        echo.terminate()
        _output(echo, ENDING)
    if not found.strip():
        reason = (complaints.strip().splitlines() or ["no answer"])[-1]
        advice = "check firewall rules for the loopback interface, ROS_DISCOVERY_SERVER and FASTRTPS_DEFAULT_PROFILES_FILE"
        return Finding("DDS", "problem", f"two processes did not find each other in {DISCOVERY_TIME:.0f} s ({reason})", advice)
    return Finding("DDS", "ok", f"round trip of a message: {1e6 * float(found):.0f} us")


def _output(process: "subprocess.Popen[str]", patience: float) -> tuple[str, str]:
    """Return a process's output once it exits; after ``patience`` [s] it is killed and its shared memory removed."""
    try:
        out, complaints = process.communicate(timeout=patience)
    except subprocess.TimeoutExpired:
        own = used_by(process.pid)
        process.kill()
        out, complaints = process.communicate()
        for file in leftovers(own):
            file.unlink(missing_ok=True)
    return out or "", complaints or ""


def shared_memory() -> Finding:
    """Check for shared memory left by killed processes."""
    left = leftovers()
    if not left:
        return Finding("shared memory", "ok", "nothing left behind")
    size = sum(file.stat().st_size for file in left if file.exists()) / 2**20
    found = f"{len(left)} files of killed processes, {size:.0f} MiB"
    return Finding("shared memory", "note", found, "ehls doctor --clean removes them")


def processors() -> Finding:
    """Check the number of processors and their frequency governors."""
    count = len(os.sched_getaffinity(0))
    governors = {file.read_text(encoding="utf-8").strip() for file in CPU.glob("cpu*/cpufreq/scaling_governor")}
    found = f"{count} usable, load {os.getloadavg()[0]:.1f}" + (f", governor {', '.join(governors)}" if governors else "")
    if count < 2:
        return Finding("processors", "note", found, "realtime at 1 kHz needs two or more; one is enough for lockstep")
    if governors - {"performance"}:
        return Finding("processors", "note", found, "for realtime: sudo cpupower frequency-set -g performance")
    return Finding("processors", "ok", found)


def clock() -> Finding:
    """Measure the wake-up latency of a 1 kHz loop."""
    start = time.monotonic() + PERIOD
    late = [sleep_until(start + k * PERIOD) - (start + k * PERIOD) for k in range(WAKE_UPS)]
    p50, p99, worst = 1e6 * np.percentile(late, [50, 99, 100])
    found = f"a 1 kHz loop wakes {p50:.0f} us late at the median, {p99:.0f} us at p99, {worst:.0f} us at worst"
    if p99 > MAX_LATENCY:
        return Finding("clock", "note", found, "too late for realtime: stop other work, or give the nodes priority")
    return Finding("clock", "ok", found)


def permissions() -> Finding:
    """Check whether realtime priority and locked memory are permitted."""
    priority = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
    memory = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    root = os.geteuid() == 0
    missing = [] if root or priority else ["realtime priority"]
    missing += [] if root or memory == resource.RLIM_INFINITY or memory >= LOCKED_MEMORY else ["locked memory"]
    if missing:
        advice = "for realtime: rtprio 50 and memlock unlimited in /etc/security/limits.d (docs/hardware.md), then log in again"
        return Finding("permissions", "note", f"{' and '.join(missing)} not permitted", advice)
    return Finding("permissions", "ok", "realtime priority and locked memory permitted")


def places() -> Finding:
    """Check the configuration folder, the kernel cache and the disk space."""
    try:
        config_folder()
    except BadInput as error:
        return Finding("files", "problem", str(error), "install the package again")
    cache = cache_folder()
    if not os.access(next(folder for folder in (cache, *cache.parents) if folder.exists()), os.W_OK):
        return Finding("files", "problem", f"{cache} cannot be written", "set EHLS_CACHE_DIR to a writable folder")
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    found = f"kernels in {cache}; {free:.1f} GB free here"
    if free < MIN_SPACE:
        return Finding("files", "note", found, "an hour of recording at 1 kHz takes about 4 GB")
    return Finding("files", "ok", found)


CHECKS: tuple[Callable[[], Finding], ...] = (
    python,
    packages,
    ros,
    environment,
    discovery,
    shared_memory,
    processors,
    clock,
    permissions,
    places,
)
"""The checks in order of output."""
