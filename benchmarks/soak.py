"""An hour at 1 kHz: does the memory of any node grow, does the loop drift?

usage: python -m benchmarks.soak [--hours 1] [--plant sim|bridge] [--timing lockstep|realtime]

Runs the graph and the recorder with the 10 kN sine, by default through the bridge on an emulated rig, and samples the memory of
every process every ten seconds. The bag is removed at the end.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from benchmarks.common import parser_of
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import load_spec
from ehls_ros.nodes.graph import Plant, run_graph

INTERVAL = 10.0
WARM_UP = 60.0
"""Start of the comparison: until then caches and queues fill [s]."""


def memory_of_children() -> dict[str, float]:
    """Return the resident memory of each child process by name [MiB]."""
    found = {}
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            fields = dict(line.split(":", 1) for line in status.read_text(encoding="utf-8").splitlines())
            words = (status.parent / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if int(fields["PPid"]) == os.getpid() and "VmRSS" in fields:
            name = next((word.decode().rpartition(".")[2] for word in words if word.startswith(b"ehls_ros.")), "?")
            found["rig-emulator" if b"rig-emulator" in words else name] = int(fields["VmRSS"].split()[0]) / 1024
    return found


class Watch(threading.Thread):
    """Samples memory until told to stop."""

    def __init__(self) -> None:
        """Start without samples."""
        super().__init__(daemon=True)
        self.samples: list[tuple[float, dict[str, float]]] = []
        self.stopped = threading.Event()

    def run(self) -> None:
        """Sample."""
        start = time.monotonic()
        while not self.stopped.wait(INTERVAL):
            self.samples.append((time.monotonic() - start, memory_of_children()))

    def table(self) -> None:
        """Print a line for each process: first, last, largest, and the slope of a linear fit."""
        print("process                          first     last  largest [MiB]   growth [MiB/h]")
        for name in sorted({name for _, sample in self.samples for name in sample}):
            rows = np.array([(when, sample[name]) for when, sample in self.samples if name in sample and when > WARM_UP])
            if len(rows) < 3:
                continue
            slope = 3600.0 * np.polyfit(rows[:, 0], rows[:, 1], 1)[0]
            print(f"{name:<28}{rows[0, 1]:10.1f}{rows[-1, 1]:9.1f}{rows[:, 1].max():9.1f}{slope:20.2f}")


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="plant time")
    parser.add_argument("--plant", choices=("sim", "bridge"), default="bridge", help="simulated rig or bridge")
    parser.add_argument("--timing", choices=("lockstep", "realtime"), default="lockstep", help="timing mode")
    options = parser.parse_args()
    path = config_folder() / "experiments" / "measured_sine_fd1.yaml"
    spec = load_spec(path)
    spec = spec._replace(settings=spec.settings._replace(duration=3600.0 * options.hours))
    emulator = None
    if options.plant == "bridge":
        command = [sys.executable, "-m", "ehls_ros.cli.main", "rig-emulator", "--spec", str(path)]
        command += ["--lockstep"] if options.timing == "lockstep" else []
        emulator = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        time.sleep(5.0)
    watch = Watch()
    watch.start()
    done = [0, spec.cycles]
    try:
        with tempfile.TemporaryDirectory() as folder:
            run_folder = RunFolder.create(Path(folder) / "run", "soak", overwrite=True)
            run_folder.write_spec(spec)

            def progress(cycle: int, cycles: int) -> None:
                if cycle - done[0] >= cycles // 20:
                    done[0] = cycle
                    print(f"  {cycle} of {cycles} cycles", flush=True)

            wall = run_graph(spec, run_folder, options.timing, "mcap", progress, Plant(options.plant))
            size = sum(file.stat().st_size for file in run_folder.bag.iterdir()) / 2**20
    finally:
        watch.stopped.set()
        if emulator is not None:
            emulator.send_signal(signal.SIGINT)
            emulator.wait(20)
    print(f"{spec.cycles} cycles in {wall:.0f} s, {spec.cycles / wall:.0f} per second; bag of {size:.0f} MiB")
    watch.table()


if __name__ == "__main__":
    main()
