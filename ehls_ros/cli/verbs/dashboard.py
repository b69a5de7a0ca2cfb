"""`ehls dashboard`: a live page of the running graph."""

import os
import threading
from argparse import ArgumentParser, Namespace

from ehls_ros.cli.arguments import add_configured, add_namespace, add_plant, check_plant, needs_ros
from ehls_ros.experiments.spec import load_spec
from ehls_ros.extras import missing

HELP = "Show a running graph live in the browser: signals, parameters, start and stop, recording, emergency stop."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    about = "experiment file to start, in a separate domain unless ROS_DOMAIN_ID is set (default: join a running graph)"
    add_configured(parser, "--spec", "experiments", about)
    parser.add_argument(
        "--timing",
        choices=("lockstep", "fastest", "realtime"),
        default="lockstep",
        help="lockstep: every cycle waits for its answers, at most as fast as real time, on any machine; fastest: the same, as"
        " fast as this machine; realtime: by the wall clock, late answers count as late (default: lockstep)",
    )
    add_plant(parser)
    add_namespace(parser)
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to serve on; from other machines, reading needs the token too"
    )
    parser.add_argument("--port", type=int, default=8766, help="port to serve on; 0: any free port (default: 8766)")


def run(options: Namespace) -> int:
    """Serve until Ctrl-C; then stop everything started from the page."""
    check_plant(options)
    spec = load_spec(options.spec) if options.spec is not None else None
    try:
        from ehls_ros.dashboard.graph import Timing
        from ehls_ros.dashboard.server import listening, serve
    except ImportError as error:
        raise missing(f"the page's libraries are missing ({error})", "dashboard", "this Python") from None
    with needs_ros():
        from ehls_ros.nodes.dashboard_graph import DashboardGraph
        from ehls_ros.nodes.graph import Plant, graph_environment
    timing = Timing[options.timing.upper()]
    with listening(options.host, options.port) as opened:
        if spec is not None:
            environment = graph_environment()
            os.environ.update({key: environment[key] for key in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")})
        graph = DashboardGraph(options.namespace, Plant(options.plant, options.bridge))

        def start() -> None:
            if spec is not None:
                print(graph.start(spec, options.spec.stem, timing).message, flush=True)

        def announce(address: str) -> None:
            print(f"{address}\n{graph.where}; Ctrl-C stops the dashboard and everything it started", flush=True)

        starting = threading.Thread(target=start)
        starting.start()
        try:
            serve(graph, opened, options.spec and options.spec.resolve(), timing, announce)
        finally:
            graph.abort()
            starting.join()
            graph.close()
    return 0
