"""Run a command slowed down to a share of the computer's speed.

``python tools/held_back.py 0.33 make test`` gives the command, and everything it starts, a third of the time of each processor;
with ``taskset -c 0`` before it, a third of one processor. ``--busy 2`` adds two endless loops per processor at full
speed, to simulate a loaded computer.

If the user may create a control group of Linux's cpu controller (version 1, usually root only) and realtime quota is left, the
group's quota limits the command. A single thread then gets up to SHARE of all processors together; realtime threads have a
separate quota of the same size. Otherwise, or with ``--stop-and-go``, all processes of the command are stopped (SIGSTOP) and
continued (SIGCONT) in turn, which slows down single and realtime threads alike.

Exits with the command's exit code, and reports on stderr the method and the processor time used.
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
AT_REST = "TtZX"
"""States of a process that is stopped or dead."""


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
            # Children inherit the group from now on.
            move(os.getpid(), group)
        process = subprocess.Popen(chosen.command)
        # Ctrl-C reaches the command directly; this process waits for its end.
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
    add("--period", type=float, default=0.1, help="period of running and pausing [s]; %(default)g")
    add("--busy", type=int, default=0, help="endless loops per processor beside the command; %(default)d")
    add("--stop-and-go", action="store_true", help="do not use a control group")
    add("share", type=float, metavar="SHARE", help="share of each processor; above 0, at most 1")
    add("command", nargs=argparse.REMAINDER, metavar="COMMAND", help="program and its arguments")
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
    """Create a control group whose processes get a share of the processors; None if the user may not."""
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
        # Realtime quota of each processor; the kernel always reserves a twentieth for other work.
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
    """Remove the group; processes left in it continue at full speed."""
    with contextlib.suppress(OSError):
        for process in (group / "cgroup.procs").read_text(encoding="ascii").split():
            with contextlib.suppress(ProcessLookupError):
                move(int(process), group.parent)
        group.rmdir()


# --- by stop and go ---------------------------------------------------------------------------------------------------


def stop_and_go(process: subprocess.Popen[bytes], share: float, period: float, spared: set[int]) -> None:
    """Let all descendants of this process run for a share of each period until the command ends.

    Args:
        process: the command.
        share: share of each period.
        period: period of running and pausing [s].
        spared: descendants that are never stopped.
    """
    # Orphans become children of this process, so that all of the command's processes stay within reach.
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    let_go = time.monotonic()
    while process.poll() is None:
        time.sleep(share * period)
        stopped: set[int] = set()
        # Repeat until no running process is left that could have started another.
        while found := [number for number in running(spared) if number not in stopped]:
            for number in found:
                with contextlib.suppress(ProcessLookupError, FileNotFoundError):
                    # Processes that the command itself has stopped meanwhile are left to it; its parent cannot do so any more.
                    if state_and_parent(number)[0] not in AT_REST:
                        os.kill(number, signal.SIGSTOP)
                        stopped.add(number)
        # Stopping takes time, during which some processes still run; count it.
        time.sleep((1.0 - share) / share * (time.monotonic() - let_go))
        let_go = time.monotonic()
        for number in stopped:
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGCONT)
        reap_others(process.pid)


def running(spared: set[int]) -> list[int]:
    """Return the descendants of this process that are neither dead nor stopped, parents before children."""
    children: dict[int, list[int]] = {}
    state = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            number = int(folder.name)
            state[number], parent = state_and_parent(number)
            children.setdefault(parent, []).append(number)
    found = [os.getpid()]
    for parent in found:
        found += [child for child in children.get(parent, ()) if child not in spared]
    return [number for number in found[1:] if state[number] not in AT_REST]


def state_and_parent(number: int) -> tuple[str, int]:
    """Return the letter of a process's state, and its parent."""
    stat = Path(f"/proc/{number}/stat").read_text(encoding="utf-8", errors="replace")
    letter, parent, *_ = stat.rpartition(") ")[2].split()
    return letter, int(parent)


def reap_others(command: int) -> None:
    """Reap orphans that became children of this process."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) and ended.si_pid != command:
            os.waitpid(ended.si_pid, 0)


if __name__ == "__main__":
    sys.exit(main())
