"""Test description for `launch_test test/nodes/launched_graph.py`: the launch file's graph, in a separate namespace.

``test_launch.py`` runs it. In lockstep, so that it does not depend on the speed of the machine.
"""

import tempfile
import time
import unittest
from pathlib import Path

import launch_testing.actions
import launch_testing.asserts
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from patience import PATIENCE
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from ehls_msgs.msg import LoaderState
from launch import LaunchDescription

ROOT = Path(__file__).resolve().parents[2]
NAMESPACE = "rig2"
ASK_AGAIN = 1.0
"""Time after which an unanswered request is repeated [s]."""

PARAMETERS = """
/**/sic_node: {ros__parameters: {compensation: 1}}
/rig2/plant_sim_node: {ros__parameters: {telemetry_rate: 20, timing: realtime}}
"""


def generate_test_description() -> LaunchDescription:
    """Include the launch file as a user would."""
    file = Path(tempfile.mkdtemp()) / "parameters.yaml"
    file.write_text(PARAMETERS, encoding="utf-8")
    arguments = {
        "spec": str(ROOT / "config" / "experiments" / "constant_fd2_sic.yaml"),
        "namespace": NAMESPACE,
        "timing": "lockstep",
        "params_file": str(file),
        "log_level": "info",
    }
    source = PythonLaunchDescriptionSource(str(ROOT / "launch" / "ehls.launch.py"))
    graph = IncludeLaunchDescription(source, launch_arguments=arguments.items())
    return LaunchDescription([graph, launch_testing.actions.ReadyToTest()])


class TestGraph(unittest.TestCase):
    """The graph while it runs."""

    def setUp(self) -> None:
        """Join the graph."""
        rclpy.init()
        self.node = rclpy.create_node("asker")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)

    def tearDown(self) -> None:
        """Leave it."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown()

    def first(self, kind, topic):
        """Return the first message of a topic."""
        received = []
        self.node.create_subscription(kind, topic, received.append, 10)
        while not received:
            self.executor.spin_once(PATIENCE)
        return received[0]

    def find(self, nodes):
        """Wait until nodes of these names are found in the namespace."""
        deadline = time.monotonic() + PATIENCE
        found = set()
        while not nodes <= found:
            assert time.monotonic() < deadline, f"found only {found}"
            self.executor.spin_once(0.1)
            found = {name for name, namespace in self.node.get_node_names_and_namespaces() if namespace == f"/{NAMESPACE}"}

    def ask(self, kind, service, request):
        """Return a service's answer; the request is repeated until the first answer, as DDS may lose one."""
        client = self.node.create_client(kind, service)
        asked, deadline = [], time.monotonic() + PATIENCE
        while not any(future.done() for future in asked):
            assert time.monotonic() < deadline, f"{service} does not answer"
            assert client.wait_for_service(PATIENCE)
            asked.append(client.call_async(request))
            self.executor.spin_until_future_complete(asked[-1], ASK_AGAIN)
        return next(future.result() for future in asked if future.done())

    def value(self, node, name):
        """Return a parameter's value."""
        return self.ask(GetParameters, f"/{NAMESPACE}/{node}/get_parameters", GetParameters.Request(names=[name])).values[0]

    def test_it_runs_in_its_namespace_with_one_clock_and_the_files_parameters(self, proc_output) -> None:
        """Check the graph that the arguments describe; then stop it."""
        state = self.first(LoaderState, f"/{NAMESPACE}/loader_state")
        assert abs(state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec - 1e-3 * state.cycle) < 1e-6
        assert self.first(Clock, "/clock").clock.sec < 10**6
        assert self.first(DiagnosticArray, "/diagnostics").status[0].hardware_id == NAMESPACE
        self.find({"reference_node", "disturbance_node", "sic_node", "plant_sim_node"})
        assert not [topic for topic, _ in self.node.get_topic_names_and_types() if topic.startswith("/ehls/")]
        assert self.value("sic_node", "compensation").double_value == 1.0
        assert self.value("sic_node", "use_sim_time").bool_value
        assert self.value("plant_sim_node", "telemetry_rate").double_value == 20.0
        # The launch argument takes precedence over the file.
        assert self.value("plant_sim_node", "timing").string_value == "lockstep"

        assert self.ask(Trigger, f"/{NAMESPACE}/emergency_stop", Trigger.Request()).success
        command = f"&& ros2 service call /{NAMESPACE}/reset_trips std_srvs/srv/Trigger && ros2 service call"
        proc_output.assertWaitFor(command, timeout=PATIENCE)


@launch_testing.post_shutdown_test()
class TestEnd(unittest.TestCase):
    """The graph's end."""

    def test_all_nodes_end_without_an_error(self, proc_info) -> None:
        """Look at the exit codes."""
        launch_testing.asserts.assertExitCodes(proc_info)
