"""`ehls rig`: emergency stop, acknowledgement, reset, enabling and state of a running rig, without `ros2 service`."""

import json
import os
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from ehls_ros.cli.arguments import add_namespace, needs_ros
from ehls_ros.errors import BadInput

if TYPE_CHECKING:
    from ehls_ros.nodes.rig_requests import RigRequests

HELP = "Stop a running rig at once, bring it back into operation, or show its state, without `ros2`."

USES = {
    "stop": "close the valve at once: emergency stop",
    "acknowledge": "release an emergency stop, by its name or the engaged one; it lasts at least a second",
    "unload": "let the load pressure decay, then close the valve: after the gate has held the piston, or to end a test",
    "reset": "clear a trip once its cause is gone; the valve stays closed",
    "enable": "let the controller's commands reach the valve again",
    "status": "state of the safety gate, causes of a trip, age of the last sample, next step",
}
"""Actions and their help."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("action", choices=tuple(USES), help="; ".join(f"{action}: {about}" for action, about in USES.items()))
    parser.add_argument(
        "stop", nargs="?", default="", metavar="STOP", help="with acknowledge: name of the stop, such as stop-1"
    )
    add_namespace(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(options: Namespace) -> int:
    """Send the request and print the answer."""
    if options.stop and options.action != "acknowledge":
        raise BadInput(f"'{options.stop}' follows '{options.action}'", "command line", "a stop's name after acknowledge only")
    with needs_ros():
        from ehls_ros.nodes.rig_requests import rig_requests
    with rig_requests(options.namespace) as rig:
        content, text = _status(rig) if options.action == "status" else _answer(rig, options.action, options.stop)
    print(json.dumps(content) if options.json else text)
    return 0


def _answer(rig: "RigRequests", action: str, stop: str) -> tuple[Any, str]:
    """Send a request; return the answer as data and as text, followed by the commands that resume operation."""
    answer = rig.acknowledge(stop) if action == "acknowledge" else getattr(rig, action)()
    if action == "stop":
        stop = answer.partition(";")[0]
        after = [f"acknowledge {stop}", "reset", "enable"]
    else:
        after = {"acknowledge": ["reset", "enable"], "unload": ["reset", "enable"], "reset": ["enable"]}.get(action, [])
    commands = [command_line(f"rig {step}", rig.namespace) for step in after]
    then = f"; next: {', then '.join(commands)}" if commands else ""
    done = f"emergency stop {stop}: the valve is closed" if action == "stop" else answer.partition(";")[0]
    content = {"done": action, "answer": answer, **({"stop": stop} if action == "stop" else {}), "next": commands}
    return content, f"{done}{then}"


def _status(rig: "RigRequests") -> tuple[Any, str]:
    """Return the state of a rig as data and as text."""
    # Seconds that an emergency stop must not wait.
    from ehls_ros.dashboard.status import STOPPED_BECAUSE, explained
    from ehls_ros.hardware.safety_gate import DRIVING, steps_to_drive

    report = rig.gate()
    sample, programme, figures = rig.sample(), rig.programme_if_any(), report.figures
    state, stop = figures.get("state", ""), figures.get("stop", "")
    causes = [explained(text) for name, text in figures.items() if name.startswith("cause_")]
    lasting = [
        name.removeprefix("fault_")
        for name, text in figures.items()
        if name.startswith("fault_") and text.endswith(", now") and not text.startswith("warn")
    ]
    obstacle = "" if causes or state in DRIVING or report.message == state else report.message
    if causes and lasting:
        obstacle = f"{', '.join(lasting)} persists"
    steps = [command_line(f"rig {step}", rig.namespace) for step in steps_to_drive(state, stop)]
    if programme is not None and STOPPED_BECAUSE in programme.figures:
        steps.append(command_line("programme resume", rig.namespace))
    content = {
        "namespace": rig.namespace,
        "domain": int(os.environ.get("ROS_DOMAIN_ID", "0")),
        "node": report.node,
        "state": state,
        "stop": stop,
        "causes": causes,
        "sample_age_s": None if sample is None else round(sample.age_s, 4),
        "cycle": None if sample is None else sample.cycle,
        "driver": figures.get("owner", ""),
        "message": report.message,
        "obstacle": obstacle,
        "next": steps,
    }
    age = "none received" if sample is None else f"{sample.age_s:.3g} s old, cycle {sample.cycle}"
    following = ", then ".join(steps) or "none: commands reach the valve"
    lines = [
        f"{report.node} in {rig.where}",
        f"  safety gate         {state}{f' by {stop}' if stop else ''}",
        *(f"  cause               {cause}" for cause in causes),
        f"  driver              {content['driver']}",
        f"  last sample         {age}",
        *([f"  message             {report.message}"] if report.level and not causes else []),
        f"  next step           {f'mend first: {obstacle}; then ' if obstacle else ''}{following}",
    ]
    return content, "\n".join(lines)


def command_line(words: str, namespace: str) -> str:
    """Return a command of `ehls` for a rig in a namespace."""
    return f"ehls {words}{'' if namespace == 'ehls' else f' --namespace {namespace}'}"
