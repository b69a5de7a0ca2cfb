"""tools/held_back.py slows a command down and passes on its exit code."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE

TOOL = Path(__file__).resolve().parents[1] / "tools" / "held_back.py"

PAUSE = 0.02
"""Duration of a pause that shows a process without other work to be held back [s]."""

LONGEST = 20.0
"""Timeout without such a pause: on a busy machine it may get less than its share [s]."""

BUSY = f"""
import os, sys, time
begin = now = time.monotonic()
def work():
    # Ends with a pause: the tool, held up itself, lets the command run on, and makes up for it in the pause that follows.
    global now
    last = begin
    while now < begin + 1.5 or last + {PAUSE} > now < begin + {LONGEST}:
        last, now = now, time.monotonic()
if os.fork() == 0:
    work()
    print(time.process_time() / (now - begin), flush=True)
    os._exit(0)
os.wait()
sys.exit(3)
"""


@pytest.mark.parametrize("options", [(), ("--stop-and-go",)])
def test_children_of_a_command_get_its_share_and_the_exit_code_is_passed_on(options):
    first = str(min(os.sched_getaffinity(0)))
    command = ["taskset", "--cpu-list", first, sys.executable, str(TOOL), *options, "0.25", sys.executable, "-c", BUSY]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 3, done.stderr
    # On a busy machine the command gets less; never much more.
    assert float(done.stdout) < 0.35
    assert done.stderr.startswith("held back to 0.25 of 1 processors by ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("0", "true"), "SHARE is 0"),
        (("1.5", "true"), "SHARE is 1.5"),
        (("0.5",), "COMMAND is missing"),
        (("0.5", "--busy", "1", "true"), "options stand before SHARE"),
        (("--period", "9", "0.5", "true"), "--period is 9"),
        (("--busy", "-1", "0.5", "true"), "--busy is -1"),
    ],
)
def test_wrong_arguments(arguments, words):
    done = subprocess.run([sys.executable, str(TOOL), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert words in done.stderr
