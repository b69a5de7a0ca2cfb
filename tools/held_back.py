"""Run a command on a computer held back to a share of its speed.

``python tools/held_back.py 0.33 make test`` gives the command, and all it starts, a third of the time of each processor they
may run on; with ``taskset -c 0`` before it, a third of one processor. With ``--busy 2`` two endless loops per processor run
beside it, which are not held back: a loaded computer.

Where this user may make a control group of Linux's cpu controller (version 1, root as a rule) and other groups have not been
promised most of the realtime there is, the group's quota holds the command back. A lone thread then gets up to SHARE of all
processors together; threads with realtime priority have a quota of the same size for themselves. Elsewhere, or with
``--stop-and-go``, all processes of the command are stopped (SIGSTOP) and let go on (SIGCONT) in turn, which holds back lone
threads and realtime ones alike.

Ends with the command's exit code, and says on stderr by which means it was held back and how much processor time it had.
"""

import argparse
import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

PR_SET_CHILD_SUBREAPER = 36
MICROSECONDS = 1e6


def main() -> int:
    """Run the command line and return the command's exit code."""
    chosen = parsed()
    processors = len(os.sched_getaffinity(0))
    with contextlib.ExitStack() as stack:
        group = None if chosen.stop_and_go else control_group(chosen.share, processors, chosen.period)
        if group is not None:
            stack.callback(remove, group)
        loops = [stack.enter_context(busy_loop()) for _ in range(chosen.busy * processors)]
        how = "stop and go" if group is None else "a control group"
        print(f"held back to {chosen.share:g} of {processors} processors by {how}", file=sys.stderr)
        begin, before = time.monotonic(), os.times()
        if group is not None:
            # What this process starts from here on belongs there as well.
            move(os.getpid(), group)
        process = subprocess.Popen(chosen.command)
        # Ctrl-C reaches the command without this process, which waits for its end.
        signal.signal(signal.SIGINT, lambda *_: None)
        signal.signal(signal.SIGTERM, lambda *_: process.terminate())
        if group is None:
            stop_and_go(process, chosen.share, chosen.period, {loop.pid for loop in loops})
        code = process.wait()
        wall, after = time.monotonic() - begin, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    print(f"{used:.1f} s of processor time in {wall:.1f} s", file=sys.stderr)
    return code if code >= 0 else 128 - code


def parsed() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="%(prog)s [--period S] [--busy N] [--stop-and-go] SHARE COMMAND...",
    )
    add = parser.add_argument
    add("--period", type=float, default=0.1, help="time of one turn of running and standing still [s]; %(default)g")
    add("--busy", type=int, default=0, help="endless loops per processor beside the command; %(default)d")
    add("--stop-and-go", action="store_true", help="even where a control group may be made")
    add("share", type=float, metavar="SHARE", help="of each processor; above 0, at most 1")
    add("command", nargs=argparse.REMAINDER, metavar="COMMAND", help="what to run, and its arguments")
    chosen = parser.parse_args()
    if not 0.0 < chosen.share <= 1.0:
        parser.error(f"SHARE is {chosen.share:g}: expected more than 0 and at most 1")
    if not 0.01 <= chosen.period <= 1.0:
        parser.error(f"--period is {chosen.period:g}: expected 0.01 to 1 s")
    if chosen.busy < 0:
        parser.error(f"--busy is {chosen.busy}: expected 0 or more")
    if not chosen.command:
        parser.error("COMMAND is missing: expected a program to run")
    if shutil.which(chosen.command[0]) is None:
        parser.error(f"COMMAND is {chosen.command[0]!r}: expected a program; options stand before SHARE")
    return chosen


@contextlib.contextmanager
def busy_loop() -> Iterator[subprocess.Popen[bytes]]:
    """Keep a processor busy."""
    with subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True) as loop:
        try:
            yield loop
        finally:
            loop.kill()


# --- by a control group -----------------------------------------------------------------------------------------------


def control_group(share: float, processors: int, period: float) -> Path | None:
    """Make a control group whose processes get a share of the processors; None where this user may not."""
    mounts = [line.split() for line in Path("/proc/mounts").read_text(encoding="utf-8").splitlines()]
    top = next(
        (Path(place) for _, place, kind, options, *_ in mounts if kind == "cgroup" and "cpu" in options.split(",")), None
    )
    if top is None:
        return None
    group = top / f"held_back_{os.getpid()}"
    turn = round(period * MICROSECONDS)
    quotas = {"cpu.cfs_period_us": turn, "cpu.cfs_quota_us": round(share * processors * turn)}
    try:
        group.mkdir()
        # Of each processor; a twentieth of it is always left to ordinary work.
        if (group / "cpu.rt_runtime_us").exists():
            quotas |= {"cpu.rt_period_us": turn, "cpu.rt_runtime_us": round(min(share, 0.9) * turn)}
        for name, value in quotas.items():
            (group / name).write_text(str(value), encoding="ascii")
    except OSError:
        remove(group)
        return None
    return group


def move(process: int, group: Path) -> None:
    """Put a process into a group."""
    (group / "cgroup.procs").write_text(str(process), encoding="ascii")


def remove(group: Path) -> None:
    """Remove the group; what still runs in it goes on without being held back."""
    with contextlib.suppress(OSError):
        for process in (group / "cgroup.procs").read_text(encoding="ascii").split():
            with contextlib.suppress(ProcessLookupError):
                move(int(process), group.parent)
        group.rmdir()


# --- by stop and go ---------------------------------------------------------------------------------------------------


def stop_and_go(process: subprocess.Popen[bytes], share: float, period: float, spared: set[int]) -> None:
    """Let all that descends from this process run for its share of each period until the command ends.

    Args:
        process: the command.
        share: of each period.
        period: of running and standing still [s].
        spared: descendants that run on.
    """
    # What loses its parent becomes a child of this process, so that all of the command stays within reach.
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    let_go = time.monotonic()
    while process.poll() is None:
        time.sleep(share * period)
        stopped: set[int] = set()
        # Again until nobody is left that has started another one meanwhile.
        while found := running(spared) - stopped:
            for number in found:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(number, signal.SIGSTOP)
            stopped |= found
        # To stop them takes time of its own, during which some still run.
        time.sleep((1.0 - share) / share * (time.monotonic() - let_go))
        let_go = time.monotonic()
        for number in stopped:
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGCONT)
        reap_others(process.pid)


def running(spared: set[int]) -> set[int]:
    """Return the descendants of this process, without those that are dead or that somebody stopped."""
    children: dict[int, list[int]] = {}
    state = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            number, _, rest = file.read_text(encoding="utf-8", errors="replace").partition(" (")
            letter, parent, *_ = rest.rpartition(") ")[2].split()
            children.setdefault(int(parent), []).append(int(number))
            state[int(number)] = letter
    found: set[int] = set()
    waiting = [os.getpid()]
    while waiting:
        new = set(children.get(waiting.pop(), ())) - spared
        found |= new
        waiting += new
    return {number for number in found if state[number] not in "TtZX"}


def reap_others(command: int) -> None:
    """Reap the children that became this process's when they lost their parents."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) and ended.si_pid != command:
            os.waitpid(ended.si_pid, 0)


if __name__ == "__main__":
    sys.exit(main())
