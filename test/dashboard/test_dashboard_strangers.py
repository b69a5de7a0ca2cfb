"""The dashboard on a graph with foreign publishers: their texts are neither executed nor kept without limit."""

import re
import sys
import time

import pytest

pytest.importorskip("nicegui", reason="needs the extra `dashboard`")
pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")
pytest.importorskip("websockets", reason="needs websockets to drive a browser")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from headless_browser import CHROMIUM, browser
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from served import answer, own_address, running, served, until

from ehls_msgs.msg import FrictionEstimate
from ehls_ros.dashboard.graph import MAX_FIGURES, MAX_NAME, MAX_TEXT, shortened, shortened_figures
from ehls_ros.nodes.dashboard_link import MAX_FOREIGN_NODES

SCRIPTS = (
    "<script>window.ran = 1</script>",
    "<img src=x onerror='window.ran = 1'>",
    '"><svg onload="window.ran = 1">',
    'x" :id="window.ran = 1',
    "x' innerHTML='<img src=x onerror=\"window.ran = 1\">",
    "{{ window.ran = 1 }}",
    "`${window.ran = 1}`",
    "</script><script>window.ran = 1</script>",
    "\x1b[31m\x07\u202ered\ud800",
)

GROWTH = 250.0
"""Maximum memory taken by foreign publishers [MB]; the middleware keeps some of their messages."""


@pytest.fixture(scope="module")
def server(nothing_left_behind):
    with served() as started:
        yield started


@pytest.fixture(scope="module")
def chromium(nothing_left_behind, tmp_path_factory):
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    with browser(tmp_path_factory.mktemp("chromium")) as started:
        yield started


def test_texts_of_the_graph_are_shown_and_not_run(server, chromium):
    said = [[shortened(text), 1, shortened(text), shortened_figures([(text, text)])] for text in SCRIPTS]
    with chromium.tab("about:blank") as tab:
        # First the nodes, then the page; then another node while the page is open.
        server.tell(said)
        tab.go(server.address)
        for named in (said, [*said, ["another <b>node</b>", 2, "<b>bold</b>", {}]]):
            server.tell(named)
            tab.click("[data-name=tab-nodes]")
            tab.until(f"document.querySelectorAll('.nodes b').length === {len(named)}")
        # By now the page has been updated several times.
        tab.until("ehlsLive.last() > 0 && document.querySelector('.trouble').innerText.includes('<b>bold</b>')")
        shown = tab.evaluate("[...document.querySelectorAll('.nodes summary > b')].map(name => name.textContent)")
        assert sorted(shown) == sorted(each[0] for each in named)
        assert tab.evaluate("window.ran ?? null") is None
        assert tab.evaluate("document.querySelectorAll('.nodes img, .nodes svg, .nodes script').length") == 0


def test_a_slow_machine_is_named_before_its_consequences(server, chromium):
    slow = "machine too slow: 720 cycles/s of 1000 asked"
    gate = ["plant_sim_node", 2, "tripped: command too old", {"state": "cut", "owner": "nobody"}]
    with chromium.tab(server.address) as tab:
        trouble = "document.querySelector('[data-name=trouble]').innerText"
        server.tell([["fasmc_node", 1, slow, {}], gate])
        tab.until(f"{trouble}.startsWith('fasmc_node: {slow}. plant_sim_node: tripped: command too old')")
        assert tab.text("state").startswith("too slow, ")
        server.tell([["fasmc_node", 1, slow, {}]])
        tab.until(f"{trouble} === 'fasmc_node: {slow}'")
        server.tell([["fasmc_node", 0, "running", {}]])
        tab.until("document.querySelector('[data-name=state]').innerText.startsWith('running, ')")
        assert not tab.text("trouble")


def test_a_read_only_page_is_complete_although_its_events_are_dropped(server, chromium):
    with chromium.tab(server.server) as tab:
        tab.until("ehlsLive.last() > 0")
        tab.click(".pause input")
        tab.until("document.querySelector('.pause input').checked")
        tab.click("summary")
        tab.until("document.querySelector('details').open")
        # This update follows the page's events, so the page was not disconnected because of them.
        server.tell([["fasmc_node", 1, "still there", {}]])
        tab.until("document.querySelector('.trouble').innerText.includes('still there')")
        assert tab.complaints == []
        assert server.requests() == []


@pytest.mark.skipif(own_address() is None, reason="needs an address besides the loopback's")
def test_a_browser_on_another_machine_shows_the_page_and_its_buttons_work(chromium):
    with (
        served("0.0.0.0") as server,
        chromium.tab(f"http://{own_address()}:{server.port}/?token={server.token}") as tab,
    ):
        tab.until("ehlsLive.last() > 0")
        tab.click("[data-name='emergency stop']")
        until(lambda: server.requests() == ["emergency stop"], "the button does nothing")
        assert tab.complaints == []


def test_texts_are_cut_to_what_a_page_can_show():
    assert shortened("running") == "running"
    assert shortened("a\x1b[31m\nb\u202e\ud800") == "a�[31m�b��"
    assert len(shortened("x" * 10_000_000)) == MAX_TEXT + 1
    kept = shortened_figures((f"{number}{'x' * 1000}", "y" * 1000) for number in range(100_000))
    assert len(kept) == MAX_FIGURES
    assert {len(name) for name in kept} == {MAX_NAME + 1}


def status(name, message="running", values=()):
    values = [KeyValue(key=key, value=value) for key, value in values]
    return DiagnosticStatus(name=name, message=message, hardware_id="ehls", values=values)


def report(*statuses):
    array = DiagnosticArray(status=list(statuses))
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    array.header.stamp.sec, array.header.stamp.nanosec = seconds, nanoseconds
    return array


def dashboard(folder):
    """Run `ehls dashboard` without a graph."""
    return running([sys.executable, "-m", "ehls_ros.cli.main", "dashboard", "--port", "0"], folder)


@pytest.fixture
def stranger(ros_domain_id):
    """Return a node outside the graph."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain_id, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("stranger", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.mark.long
def test_whatever_others_publish_the_dashboard_goes_on_and_stays_small(stranger, tmp_path):
    publisher = stranger.create_publisher(DiagnosticArray, "/diagnostics", 10)
    friction = stranger.create_publisher(FrictionEstimate, "/ehls/friction_estimate", 10)
    broken = serialize_message(report(status("broken", "m" * 50)))
    with dashboard(tmp_path) as server:
        here = f"http://127.0.0.1:{server.port}/"
        names = set()
        until(lambda: publisher.get_subscription_count() == 1, "the dashboard does not listen")

        def shown():
            # After too many requests there is no page for a while, and no name.
            text = answer(f"{here}?token={server.token}")[1]
            return {name.removeprefix("node-") for name in re.findall(r'"data-name":"(node-[^"]*)"', text)}

        def until_heard(name):
            """Publish diagnostics of a node of the graph until the page shows it."""

            def heard():
                publisher.publish(report(status(name)))
                time.sleep(0.2)
                return name in shown()

            until(heard, f"{name} is not heard")

        until_heard("fasmc_node")
        before = server.memory()
        for length in (0, 1, 4, 100_000):
            friction.publish(FrictionEstimate(element_forces=[1.0] * length, slipping=[True] * length))
        for _ in range(5):
            publisher.publish(report(status("long", "x" * 10_000_000)))
            publisher.publish(report(status("y" * 10_000_000)))
            publisher.publish(report(status("many", values=[(f"key {i}", "value") for i in range(100_000)])))
        publisher.publish(broken.replace(b"m" * 50, b"\xff" * 50))
        publisher.publish(report(*(status(script.encode("utf-8", "replace").decode()) for script in SCRIPTS)))
        until_heard("friction_estimator_node")
        for number in range(10_000):
            publisher.publish(report(status(f"stranger {number} {'x' * 1000}")))
        until_heard("plant_sim_node")
        until(lambda: names.update(shown()) or names, "no page is served")
        assert len(names - {"fasmc_node", "friction_estimator_node", "plant_sim_node"}) <= MAX_FOREIGN_NODES
        assert max(map(len, names)) <= 2 * MAX_NAME
        assert "long" not in names
        assert server.memory() - before < GROWTH
        assert "Traceback" not in server.said()
