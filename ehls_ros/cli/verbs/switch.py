"""`ehls switch`: hand the valve over to another running controller, without `ros2 service`."""

import json
import sys
from argparse import ArgumentParser, Namespace

from ehls_ros.cli.arguments import needs_ros

HELP = "Hand the valve to a controller node that stands by, without a bump."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("node", metavar="NODE", help="the controller's node, by its full name or its last part")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(options: Namespace) -> int:
    """Ask the plant node and print its answer."""
    with needs_ros():
        from ehls_ros.nodes.parameter_requests import requests
    with requests() as ask:
        node = ask.resolve(options.node)
        answer = ask.switch(node, lambda reason: print(reason, file=sys.stderr, flush=True))
    print(json.dumps({"node": node, "answer": answer}) if options.json else answer)
    return 0
