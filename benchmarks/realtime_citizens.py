"""Load of a realtime graph on the rest of the machine: memory, page faults, and processors when overloaded.

usage: realtime_citizens.py [--seconds 60] [--priority 10] [--skip-share]

First, the five nodes of the simulated rig run at SCHED_FIFO: locked and resident memory of each, and page faults per second of
its loop and its process. Then one overloaded node per processor, whose loop never rests, runs beside one normal busy process
each. The table has the share of the processor that this process gets, with `processor_share` off and on.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import load_spec
from ehls_ros.nodes.control import ControlNode
from ehls_ros.nodes.graph import SIMULATED, graph_environment, node_parameters, node_processes
from ehls_ros.nodes.graph_nodes import RECORDER
from ehls_ros.nodes.running import run_node

WARM_UP = 15.0
"""Time for nodes to start, load their kernels and fill their queues [s]."""

OVERLOAD = 0.005
"""Duration of one turn of an overloaded loop [s]."""


class OverloadedNode(ControlNode):
    """A node whose loop never rests."""

    def __init__(self) -> None:
        """Name the node after its process id, so that names are unique."""
        super().__init__(f"overloaded_{os.getpid()}")

    def prepare(self) -> None:
        """Nothing to prepare."""

    def once(self) -> None:
        """Work without pause."""
        end = time.monotonic() + OVERLOAD
        while time.monotonic() < end:
            pass


def figures(process: int) -> tuple[int, int, list[int]]:
    """Return locked and resident memory [KiB], and the minor and major faults of the loop and of the process."""
    status = dict(line.split(":", 1) for line in Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines())
    faults = []
    for file in (f"/proc/{process}/task/{process}/stat", f"/proc/{process}/stat"):
        fields = Path(file).read_text(encoding="utf-8").rsplit(")", 1)[1].split()
        faults += [int(fields[7]), int(fields[9])]
    return int(status["VmLck"].split()[0]), int(status["VmRSS"].split()[0]), faults


def show_memory(seconds: float, priority: int) -> None:
    """Run the five nodes and print a line for each."""
    spec = load_spec(config_folder() / "experiments" / "sine_fd2.yaml")
    with tempfile.TemporaryDirectory() as place:
        folder = RunFolder.create(Path(place) / "run", "benchmark", overwrite=True)
        folder.write_spec(spec)
        folder.logs.mkdir()
        parameters = node_parameters(spec, SIMULATED, folder, "realtime", "mcap")
        del parameters[RECORDER]
        for own in parameters.values():
            own |= {"autostart": True, "priority": priority}
        parameters[SIMULATED.node]["cycles"] = 0
        with node_processes(list(parameters), parameters, folder.logs, graph_environment()) as running:
            time.sleep(WARM_UP)
            before = [figures(node.process.pid)[2] for node in running]
            time.sleep(seconds)
            print("node                     VmLck  VmRSS [MiB]  faults/s: loop minor, major; process minor, major")
            for node, earlier in zip(running, before, strict=True):
                locked, resident, faults = figures(node.process.pid)
                rates = [(now - then) / seconds for now, then in zip(faults, earlier, strict=True)]
                print(f"{node.name:24}{locked / 1024:6.0f}{resident / 1024:7.0f}      ", *(f"{rate:8.2f}" for rate in rates))


def show_share(seconds: float, priority: int, share: float) -> None:
    """Run overloaded nodes beside normal work and print the shares of both."""
    processors = sorted(os.sched_getaffinity(0))
    arguments = ["--ros-args", "-p", f"priority:={priority}", "-p", f"processor_share:={share}"]
    nodes = [
        subprocess.Popen([sys.executable, __file__, "--be-overloaded", *arguments], env=graph_environment()) for _ in processors
    ]
    ordinary = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in processors]
    try:
        for process, processor in zip(ordinary, processors, strict=True):
            os.sched_setaffinity(process.pid, {processor})
        time.sleep(WARM_UP)
        watched = (*ordinary, *nodes)
        before = [busy(process.pid) for process in watched]
        start = time.monotonic()
        time.sleep(seconds)
        elapsed = time.monotonic() - start
        parts = [f"{100 * (busy(process.pid) - then) / elapsed:.0f} %" for process, then in zip(watched, before, strict=True)]
        own, theirs = ", ".join(parts[: len(ordinary)]), ", ".join(parts[len(ordinary) :])
        print(f"processor_share {share}: normal work got {own} of a processor, the overloaded nodes {theirs}", flush=True)
    finally:
        for process in (*nodes, *ordinary):
            process.terminate()
        for process in (*nodes, *ordinary):
            process.wait(30)


def busy(process: int) -> float:
    """Return the processor time of a process [s]."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each measurement")
    parser.add_argument("--priority", type=int, default=10, help="SCHED_FIFO priority of the nodes")
    parser.add_argument("--skip-share", action="store_true", help="leave the overloaded nodes out")
    parser.add_argument("--be-overloaded", action="store_true", help=argparse.SUPPRESS)
    options, _ = parser.parse_known_args()
    if options.be_overloaded:
        run_node(OverloadedNode)
    print(
        f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}, Python {platform.python_version()}"
    )
    show_memory(options.seconds, options.priority)
    for share in () if options.skip_share else (1.0, 0.9):
        show_share(options.seconds, options.priority, share)


if __name__ == "__main__":
    main()
