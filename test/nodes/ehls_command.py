"""The command `ehls` as a process, and its recording."""

import json
import subprocess
import sys
from pathlib import Path

from patience import PATIENCE

from ehls_ros.recording.bag_reader import read_bag


def ehls(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "ehls_ros.cli.main", *map(str, arguments)]
    return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE, check=False)


def trajectory_of(done: subprocess.CompletedProcess[str]):
    assert done.returncode == 0, done.stderr
    return read_bag(Path(json.loads(done.stdout.splitlines()[-1])["bag"]))
