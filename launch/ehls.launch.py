"""The whole graph: ``ros2 launch ehls_ros ehls.launch.py plant:=sim controller:=fasmc rig:=config/rig_paper.yaml``.

A node can be left out (``without:=fasmc_node``) and started by hand instead. A second rig runs beside the first in a namespace
of its own (``namespace:=rig2``): only /diagnostics is shared, where its nodes are named ``rig2/...``.
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.launch_context import LaunchContext
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

ARGUMENTS = {
    "plant": ("sim", "sim: the simulated rig; bridge: the real one", ["sim", "bridge"]),
    "bridge": ("", "bridge file for plant:=bridge: DAQ backend, channels, calibration; empty: UDP to this host", None),
    "controller": (
        "fasmc",
        "control law; fasmc_output_feedback needs no velocity; pid follows a position and needs a spec with one",
        ["fasmc", "fasmc_output_feedback", "sic", "pid"],
    ),
    "rig": ("", "rig file in place of the spec's", None),
    "spec": ("", "experiment file; empty: the 10 kN sine that comes with the package", None),
    "timing": (
        "realtime",
        "realtime: wall clock; lockstep: deterministic, as fast as the machine goes",
        ["realtime", "lockstep"],
    ),
    "priority": ("0", "in realtime: SCHED_FIFO priority of the nodes, 1 to 99; 0: none", None),
    "namespace": ("ehls", "namespace of nodes and topics; one of its own for each further rig, such as rig2", None),
    "record": ("", "folder to record a bag into; empty: no recording", None),
    "without": ("", "nodes to leave out, separated by commas", None),
}

PLANTS = {"sim": "plant_sim_node", "bridge": "hardware_bridge_node"}


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes the arguments ask for."""
    chosen = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    common = {"spec": chosen["spec"], "rig": chosen["rig"], "timing": chosen["timing"], "priority": int(chosen["priority"])}
    own: dict[str, dict[str, object]] = {
        "reference_node": {},
        "friction_estimator_node": {},
        f"{chosen['controller']}_node": {},
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
            executable=name,
            namespace=chosen["namespace"],
            parameters=[{**common, **parameters}],
            output="screen",
        )
        for name, parameters in own.items()
        if name not in left_out
    ]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the nodes."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description, choices=choices)
        for name, (default, description, choices) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
