"""The security policy matches the graph, and a node stays on this host unless configured otherwise."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from tiers import tiered

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from patience import PATIENCE

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.nodes import controller_of, node_names
from ehls_ros.nodes.graph_nodes import PLANTS
from ehls_ros.recording.topics import CYCLE_TOPICS, TOPICS

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "config" / "sros2" / "policy.xml"
NODES = node_names()
INCLUDE = "{http://www.w3.org/2001/XInclude}include"
KINDS = {"publish": "topics", "subscribe": "topics", "reply": "services", "request": "services"}

Rights = dict[str, set[str]]


def policy() -> dict[str, Rights]:
    """Return the topics and services that each node may publish, subscribe, reply and request, by full names."""
    rights: dict[str, Rights] = {}
    for profile in ET.parse(POLICY).iter("profile"):
        name, namespace = profile.attrib["node"], profile.attrib["ns"]
        rights[name] = {right: set() for right in KINDS}
        parts = list(profile)
        for include in profile.findall(INCLUDE):
            assert include.attrib["xpointer"] == "xpointer(/profile/*)"
            parts += list(ET.parse(POLICY.parent / include.attrib["href"]).getroot())
        for part in parts:
            for right, permission in part.attrib.items() if part.tag in KINDS.values() else ():
                assert part.tag == KINDS[right]
                assert permission == "ALLOW"
                rights[name][right] |= {resolved(entry.text or "", namespace, name) for entry in part}
    return rights


def resolved(name: str, namespace: str, node: str) -> str:
    if name.startswith("~/"):
        return f"{namespace}/{node}/{name[2:]}"
    return name if name.startswith("/") else f"{namespace}/{name}"


def test_every_executable_has_its_own_enclave():
    enclaves = {
        enclave.attrib["path"]: [profile.attrib["node"] for profile in enclave.iter("profile")]
        for enclave in ET.parse(POLICY).iter("enclave")
    }
    assert enclaves == {f"/ehls/{name}": [name] for name in [*NODES, "conductor"]}


def test_every_topic_has_its_publishers_and_the_recorder():
    rights = policy()
    for topic in TOPICS:
        assert topic.resolve() in rights["recorder_node"]["subscribe"]
        assert any(topic.resolve() in rights[name]["publish"] for name in NODES)


def test_only_controllers_command_the_valve_and_only_plant_nodes_open_a_cycle():
    rights = policy()

    def publishers(topic: str) -> set[str]:
        return {name for name, right in rights.items() if f"/ehls/{topic}" in right["publish"]}

    assert publishers("valve_command") == {f"{name}_node" for name in CONTROLLERS.names()}
    assert publishers("loader_state") == set(PLANTS.values())
    assert {name for name, right in rights.items() if "/ehls/enable" in right["request"]} == {"conductor"}
    assert all("/ehls/enable" in rights[name]["reply"] for name in PLANTS.values())


@pytest.mark.long
def test_the_nodes_stay_within_the_policy(graph, participant, spec_file, tmp_path: Path):
    rights = policy()
    spec = spec_file()
    position = tmp_path / "position.yaml"
    position.write_text(
        (ROOT / "config" / "experiments" / "constant_velocity.yaml")
        .read_text(encoding="utf-8")
        .replace("../", f"{ROOT}/config/"),
        encoding="utf-8",
    )
    for name in NODES:
        controller = controller_of(name)
        follows = CONTROLLERS.load(controller).FOLLOWS if controller else "force"
        more = {
            "recorder_node": {"bag": tmp_path / "bag"},
            "programme_node": {"programme": "service_load", "folder": tmp_path / "programme"},
            "monitor_node": {"folder": tmp_path / "monitor"},
        }.get(name, {})
        # A configured node has all its topics and services.
        graph.start(name, spec=spec if follows == "force" else position, autostart=False, **more)
    for name in NODES:
        assert participant.change(name, "configure"), graph.log(name)
    known = [topic.resolve() for topic in CYCLE_TOPICS]
    ask = participant.node
    for name in NODES:
        participant.until(lambda name=name: (name, "/ehls") in ask.get_node_names_and_namespaces())

        def used(right: str, name: str = name) -> set[str]:
            asked = {
                "publish": ask.get_publisher_names_and_types_by_node,
                "subscribe": ask.get_subscriber_names_and_types_by_node,
                "reply": ask.get_service_names_and_types_by_node,
                "request": ask.get_client_names_and_types_by_node,
            }
            # The recorder queries every node it discovers, the test's as well.
            return {found for found, _ in asked[right](name, "/ehls") if not found.startswith(f"/ehls/{ask.get_name()}/")}

        # Discovery is gradual: a node is complete once its control-path topic is known.
        participant.until(lambda used=used: any(topic in used("publish") | used("subscribe") for topic in known))
        participant.until(lambda used=used, name=name: f"/ehls/{name}/get_state" in used("reply"))
        for right in KINDS:
            assert used(right) <= rights[name][right], f"{name} {right}"


def udp_ports(process: int) -> Iterator[int]:
    """Yield the UDP ports a process is bound to."""
    sockets = set()
    for link in Path(f"/proc/{process}/fd").iterdir():
        # A file may be closed meanwhile.
        with contextlib.suppress(FileNotFoundError):
            sockets.add(str(link.readlink()))
    for line in Path("/proc/net/udp").read_text(encoding="utf-8").splitlines()[1:]:
        fields = line.split()
        if f"socket:[{fields[9]}]" in sockets:
            yield int(fields[1].partition(":")[2], 16)


@pytest.mark.parametrize(
    ("range_", "found"),
    tiered([(None, False), ("", False), ("LOCALHOST", False), ("SUBNET", True)], (None, False), ("SUBNET", True), unpack=True),
)
def test_a_node_listens_to_other_hosts_only_when_told_to(ros_domain_id: int, range_: str | None, found: bool):
    environment = {key: value for key, value in os.environ.items() if key != "ROS_AUTOMATIC_DISCOVERY_RANGE"}
    if range_ is not None:
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = range_
    node = subprocess.Popen(
        [sys.executable, "-m", "ehls_ros.nodes.reference_node"],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert any(line.rstrip().endswith("up") for line in node.stdout)
        # The port of DDS's multicast discovery.
        assert (7400 + 250 * ros_domain_id in udp_ports(node.pid)) is found
    finally:
        node.send_signal(signal.SIGINT)
        node.communicate(timeout=PATIENCE)
