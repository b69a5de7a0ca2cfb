"""`ehls foxglove`: stream recordings and simulations to Foxglove."""

import signal
from argparse import ArgumentParser, Namespace
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING

from ehls_ros.cli.arguments import add_columns, add_configured, check_range, columns_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import run_in_stretches
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import load_spec
from ehls_ros.extras import missing
from ehls_ros.process import Stopping
from ehls_ros.recording.load import load
from ehls_ros.recording.topics import NAMESPACE, Topic

if TYPE_CHECKING:
    from ehls_ros.report.foxglove import Source

HELP = "Stream a recording, a simulation, or both on one clock to Foxglove, without ROS."

SIMULATED = "/sim"
"""Namespace of the simulation."""

LARGEST_RATE = 100.0


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("data", type=Path, nargs="?", help="bag folder, .mcap, .db3, .csv or the folder of a run; on /ehls/...")
    add_columns(parser)
    add_configured(parser, "--simulate", "experiments", "experiment file to simulate as it plays; on /sim/...", metavar="SPEC")
    parser.add_argument("--rate", type=float, default=1.0, help="playback speed: seconds of data per second (default: 1)")
    parser.add_argument("--host", default="127.0.0.1", help="address to serve on (default: 127.0.0.1, this machine only)")
    parser.add_argument("--port", type=int, default=8765, help="port to serve on; 0: any free port (default: 8765)")


def run(options: Namespace) -> int:
    """Serve until Ctrl-C."""
    _check(options)
    try:
        from ehls_ros.report.foxglove import FoxgloveServer, serve
    except ImportError as error:
        raise missing(f"foxglove-sdk is missing ({error})", "foxglove", "this Python") from None
    sources, topics = _sources(options)
    stopping = Stopping()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    with FoxgloveServer(options.host, options.port, topics) as server:
        print(f"ws://{options.host}:{server.port}", flush=True)
        print(f"{', '.join(topics)}: in Foxglove, Open connection, Foxglove WebSocket, this address. Ctrl-C stops.", flush=True)
        serve(server, sources, options.rate, stopping)
    return 0


def _check(options: Namespace) -> None:
    if options.data is None and options.simulate is None:
        raise BadInput("there is nothing to stream", "command line", "data, --simulate SPEC, or both")
    if options.columns is not None and options.data is None:
        raise BadInput("--columns was given", "command line", "data with it")
    if not 0.0 < options.rate <= LARGEST_RATE:
        raise BadInput(f"--rate is {options.rate:g}", "command line", f"a number above 0 up to {LARGEST_RATE:g}")
    check_range(options, "port", 0, 65535, "a port from 0 to 65535")
    try:
        ip_address(options.host)
    except ValueError:
        raise BadInput(f"--host is '{options.host}'", "command line", "an IP address such as 127.0.0.1") from None


def _sources(options: Namespace) -> tuple[list["Source"], dict[str, list[Topic]]]:
    """Return the sources to stream, and their topics by namespace."""
    from ehls_ros.report.foxglove import Source, in_stretches, topics_of

    sources: list[Source] = []
    topics: dict[str, list[Topic]] = {}
    start_s = 0.0
    if options.data is not None:
        bag = RunFolder(options.data).bag
        recorded = load(bag if bag.is_dir() else options.data, columns_of(options))
        start_s = float(recorded.time_s[0])
        sources.append(Source(NAMESPACE, start_s, partial(in_stretches, recorded)))
        topics[NAMESPACE] = topics_of(recorded)
    if options.simulate is not None:
        spec = load_spec(options.simulate)
        sources.append(Source(SIMULATED, start_s, partial(run_in_stretches, spec)))
        topics[SIMULATED] = topics_of(next(run_in_stretches(spec)))
    return sources, topics
