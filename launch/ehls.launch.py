"""The complete graph: ``ros2 launch ehls_ros ehls.launch.py plant:=sim controller:=fasmc rig:=config/rig_paper.yaml``.

A node can be left out (``without:=fasmc_node``) and started by hand instead. A second rig runs beside the first in its own
namespace (``namespace:=rig2``): only /diagnostics is shared, where its nodes are named ``rig2/...``.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.launch_context import LaunchContext
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.experiments.spec import chosen_spec
from ehls_ros.nodes.frames import frame_prefix, robot_description
from launch import LaunchDescription

ARGUMENTS = {
    "plant": ("sim", "sim: the simulated rig; bridge: the real one", ["sim", "bridge"]),
    "bridge": ("", "bridge file for plant:=bridge: DAQ backend, channels, calibration; empty: UDP to this host", None),
    "controller": (
        "fasmc",
        "control law; it must follow what the spec's reference is, a force or a position",
        list(CONTROLLERS.names()),
    ),
    "rig": ("", "rig file in place of the spec's", None),
    "spec": ("", "experiment file; empty: the 10 kN sine that comes with the package", None),
    "timing": (
        "realtime",
        "realtime: wall clock; lockstep: deterministic, as fast as the machine goes",
        ["realtime", "lockstep"],
    ),
    "priority": ("0", "in realtime: SCHED_FIFO priority of the nodes, 1 to 99; 0: none", None),
    "namespace": ("ehls", "namespace of nodes and topics; a second rig needs its own, such as rig2", None),
    "record": ("", "folder to record a bag into; empty: no recording", None),
    "frames": (
        "true",
        "true: start robot_state_publisher, if it is installed, so that RViz and Foxglove show the rig moving",
        ["true", "false"],
    ),
    "without": ("", "nodes to leave out, separated by commas", None),
}

PLANTS = {"sim": "plant_sim_node", "bridge": "hardware_bridge_node"}

ROBOT_STATE_PUBLISHER = "robot_state_publisher"


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes that the arguments select."""
    chosen = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    common = {"spec": chosen["spec"], "rig": chosen["rig"], "timing": chosen["timing"], "priority": int(chosen["priority"])}
    controller = f"{chosen['controller']}_node"
    own: dict[str, dict[str, object]] = {
        "reference_node": {},
        "friction_estimator_node": {},
        controller: {},
        PLANTS[chosen["plant"]]: {},
    }
    if chosen["plant"] == "bridge":
        own[PLANTS["bridge"]]["bridge"] = chosen["bridge"]
    if chosen["plant"] == "sim":
        own["disturbance_node"] = {}
    if chosen["record"]:
        own["recorder_node"] = {"bag": chosen["record"]}
    left_out = set(chosen["without"].split(","))
    return [
        Node(
            package="ehls_ros",
            # A controller of another package has no executable in this one; `ehls run` starts any.
            executable="ehls" if name == controller else name,
            arguments=["run", name] if name == controller else [],
            namespace=chosen["namespace"],
            parameters=[{**common, **parameters}],
            output="screen",
        )
        for name, parameters in own.items()
        if name not in left_out
    ]


def frames(context: LaunchContext) -> list[Node | LogInfo]:
    """Return the node that publishes the rig's frames and its description, or a word on why there is none."""
    chosen = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
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
                    "use_sim_time": chosen["timing"] == "lockstep",
                }
            ],
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
