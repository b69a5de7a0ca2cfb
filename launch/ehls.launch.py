"""The complete graph: ``ros2 launch ehls_ros ehls.launch.py plant:=sim spec:=config/experiments/sine_fd2.yaml``.

The plant starts last, once its partners are active. A node can be left out (``without:=fasmc_node``) and started by hand
instead. A second rig runs beside the first in a separate namespace (``namespace:=rig2``): only /diagnostics is shared, where
its nodes are named ``rig2/...``. In lockstep it also needs a separate ``clock:=/rig2/clock``.
"""

import atexit
import tempfile
from pathlib import Path

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.launch_context import LaunchContext
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import BadInput
from ehls_ros.experiments.graph_check import Graph, bridge_at, check_fit
from ehls_ros.experiments.real_rig import for_real_rig
from ehls_ros.experiments.spec import COMMAND_DELAY, Use, chosen_spec, for_simulated_rig, spec_to_mapping, with_programme
from ehls_ros.experiments.yaml_files import spec_text
from ehls_ros.nodes import SUFFIX
from ehls_ros.nodes.frames import frame_prefix, robot_description
from ehls_ros.nodes.graph_nodes import (
    LOCKSTEP,
    MONITOR,
    PLANTS,
    PLUS,
    PROGRAMME,
    REALTIME,
    RECORDER,
    nodes_of,
    processes_of,
)
from launch import LaunchDescription

ARGUMENTS = {
    "plant": ("sim", "sim: the simulated rig; fmu: an FMU in its place; bridge: the real rig", list(PLANTS)),
    "plant_fmu": ("", "FMU for plant:=fmu", None),
    "plant_map": ("", "for plant:=fmu: map of the FMU's variables and units; empty: they have the names of the signals", None),
    "bridge": ("", "bridge file for plant:=bridge: DAQ backend, channels, calibration; empty: UDP to this host", None),
    "adapt": ("true", "with plant:=bridge: adapt to wrong numbers of the rig file while it runs", ["true", "false"]),
    "controller": (
        "",
        "control law; it must follow what the spec's reference is, a force or a position; empty: the spec's",
        ["", *CONTROLLERS.names()],
    ),
    "rig": ("", "rig file in place of the spec's", None),
    "spec": ("", "experiment file; empty: the 10 kN sine that comes with the package", None),
    "programme": (
        "",
        "test programme in place of the spec's reference: programme_node runs it; log and state go to runs/",
        None,
    ),
    "timing": (
        REALTIME,
        "realtime: wall clock; lockstep: deterministic, as fast as the machine goes, with the time on the clock topic",
        [REALTIME, LOCKSTEP],
    ),
    "compose": (
        "false",
        "true: the nodes of a control cycle are one process, in which a cycle is one call: much less time and processor",
        ["true", "false"],
    ),
    "use_sim_time": ("false", "in realtime: the time is that of the clock topic; in lockstep it always is", ["true", "false"]),
    "clock": ("/clock", "clock topic", None),
    "priority": ("0", "in realtime: SCHED_FIFO priority of the nodes, 1 to 99; 0: none", None),
    "params_file": ("", "ROS parameter file for all nodes; arguments given here take precedence", None),
    "autostart": ("true", "configure and activate the nodes; false: wait for lifecycle requests", ["true", "false"]),
    "namespace": ("ehls", "namespace of nodes and topics; a second rig needs its own, such as rig2", None),
    "log_level": ("info", "least severity that is logged: debug, info, warn, error or fatal", None),
    "record": ("", "folder to record a bag into; empty: no recording", None),
    "monitor": ("false", "true: watch the rig's health; memory and flight recorder go to runs/monitor", ["true", "false"]),
    "baseline": ("", "with the monitor: recordings from when the rig was well, separated by commas", None),
    "frames": (
        "true",
        "true: start robot_state_publisher, if it is installed, so that RViz and Foxglove show the rig moving",
        ["true", "false"],
    ),
    "without": ("", "nodes to leave out, separated by commas", None),
}

ROBOT_STATE_PUBLISHER = "robot_state_publisher"


def arguments(context: LaunchContext) -> dict[str, str]:
    """Return the arguments' values; in lockstep the time is always that of the clock topic."""
    chosen = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    return chosen | ({"use_sim_time": "true"} if chosen["timing"] == LOCKSTEP else {})


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes that the arguments select.

    Raises:
        BadInput: the spec is wrong, or spec, bridge and controller do not fit together.
    """
    chosen = arguments(context)
    spec = chosen_spec(chosen["spec"], chosen["rig"])
    law = chosen["controller"] or spec.controller.name
    if chosen["bridge"] and chosen["plant"] != "bridge":
        raise BadInput(f"bridge is {chosen['bridge']}", "launch argument", "plant:=bridge with it")
    for name in ("plant_fmu", "plant_map"):
        if chosen[name] and chosen["plant"] != "fmu":
            raise BadInput(f"{name} is {chosen[name]}", "launch argument", "plant:=fmu with it")
    if chosen["plant"] == "fmu" and not chosen["plant_fmu"]:
        raise BadInput("plant is fmu", "launch argument", "plant_fmu:=FILE with it")
    bridge = bridge_at(Path(chosen["bridge"]) if chosen["bridge"] else None) if chosen["plant"] == "bridge" else None
    checked = with_programme(spec, chosen["programme"])
    check_fit(checked, Graph(law, bridge, lockstep=chosen["timing"] == LOCKSTEP), chosen["spec"] or "sine_fd2")
    common: dict[str, object] = {name: chosen[name] for name in ("spec", "rig", "timing")}
    common["priority"] = int(chosen["priority"])
    common |= {name: chosen[name] == "true" for name in ("autostart", "use_sim_time")}
    # An argument that was not given leaves the parameter to the file.
    common = {name: value for name, value in common.items() if chosen[name] != ARGUMENTS[name][0]}
    left_out = set(chosen["without"].split(","))
    *names, plant = nodes_of(
        spec,
        chosen["plant"],
        law,
        record=bool(chosen["record"]),
        monitor=chosen["monitor"] == "true",
        programme=bool(chosen["programme"]),
        estimate=True,
    )
    # The rig does not wait for nodes that only observe it.
    own: dict[str, dict[str, object]] = {
        RECORDER: {"bag": chosen["record"]},
        MONITOR: {"baseline": chosen["baseline"]} if chosen["baseline"] else {},
        plant: {"partners": ",".join(name for name in names if name not in {*left_out, MONITOR})},
    }
    used = spec
    if law != spec.controller.name:
        used = spec._replace(controller=Use(law, tuned_for(CONTROLLERS.load(law).Parameters, spec.controller_rig)))
    if chosen["plant"] == "sim" and not chosen["params_file"]:
        fitted = for_simulated_rig(used).controller
        if fitted != used.controller:
            own[law + SUFFIX] = {COMMAND_DELAY: fitted.parameters.command_delay}
    if chosen["plant"] == "bridge":
        real = for_real_rig(used, adapt=chosen["adapt"] == "true")
        own[law + SUFFIX] = {"spec": _temporary(spec_text(spec_to_mapping(real.spec))), "rig": ""}
    if chosen["programme"]:
        own[PROGRAMME] = {"programme": chosen["programme"]}
        own[RECORDER]["programme"] = chosen["programme"]
    if chosen["bridge"]:
        own[plant]["bridge"] = chosen["bridge"]
    own[plant] |= {name: chosen[name] for name in ("plant_fmu", "plant_map") if chosen[name]}
    given = {name: {**common, **own.get(name, {})} for name in (*names, plant) if name not in left_out}
    processes = processes_of(list(given), compose=chosen["compose"] == "true")
    return [_process(name, given, law + SUFFIX, chosen) for name in processes]


def _temporary(text: str) -> str:
    """Return the path of a file with a text for the nodes' processes; it is removed when the launch ends."""
    with tempfile.NamedTemporaryFile("w", prefix="ehls_", suffix=".yaml", delete=False) as file:
        file.write(text)
    atexit.register(Path(file.name).unlink, missing_ok=True)
    return file.name


def _process(name: str, own: dict[str, dict[str, object]], controller: str, chosen: dict[str, str]) -> Node:
    """Return the process of one node, or of several whose names PLUS joins; each has separate parameters."""
    is_shared = PLUS in name
    parameters: object = own.get(name)
    if is_shared:
        by_node = {f"/**/{node}": {"ros__parameters": own[node]} for node in name.split(PLUS) if own[node]}
        parameters = _temporary(yaml.safe_dump(by_node))
    # A controller of another package has no executable in this one; `ehls run` starts any.
    by_ehls = is_shared or name == controller
    return Node(
        package="ehls_ros",
        executable="ehls" if by_ehls else name,
        arguments=["run", name] if by_ehls else [],
        # The same name would be given to all nodes of the process.
        name=None if is_shared else name,
        namespace=chosen["namespace"],
        parameters=[*filter(None, [chosen["params_file"]]), parameters],
        remappings=[("/clock", chosen["clock"])],
        ros_arguments=["--log-level", chosen["log_level"]],
        output="screen",
    )


def frames(context: LaunchContext) -> list[Node | LogInfo]:
    """Return the node that publishes the rig's frames and its description, or a log entry on why there is none."""
    chosen = arguments(context)
    if chosen["frames"] != "true":
        return []
    try:
        get_package_prefix(ROBOT_STATE_PUBLISHER)
    except PackageNotFoundError:
        return [LogInfo(msg=f"no {ROBOT_STATE_PUBLISHER} is installed: the rig is not shown moving; all else runs")]
    description = robot_description(chosen_spec(chosen["spec"], chosen["rig"]).rig)
    return [
        Node(
            package=ROBOT_STATE_PUBLISHER,
            executable=ROBOT_STATE_PUBLISHER,
            namespace=chosen["namespace"],
            parameters=[
                {
                    "robot_description": ParameterValue(description, value_type=str),
                    "frame_prefix": frame_prefix(f"/{chosen['namespace']}"),
                    "use_sim_time": chosen["use_sim_time"] == "true",
                }
            ],
            remappings=[("/clock", chosen["clock"])],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the nodes."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description, choices=choices)
        for name, (default, description, choices) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes), OpaqueFunction(function=frames)])
