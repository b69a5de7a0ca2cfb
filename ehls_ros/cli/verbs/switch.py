"""`ehls switch`: hand the valve over to another running controller, without `ros2 service`."""

import json
from argparse import ArgumentParser, Namespace

from ehls_ros.errors import BadInput

HELP = "Hand the valve to a controller node that stands by, without a bump."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("node", metavar="NODE", help="the controller's node, by its full name or its last part")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(options: Namespace) -> int:
    """Ask the plant node and print its answer."""
    try:
        from ehls_ros.nodes.parameter_requests import requests
    except ImportError as error:
        raise BadInput(f"ROS 2 cannot be imported ({error})", "this Python", "ROS 2 Jazzy sourced, or `make setup`") from None
    with requests() as ask:
        node = ask.resolve(options.node)
        answer = ask.switch(node)
    print(json.dumps({"node": node, "answer": answer}) if options.json else answer)
    return 0
