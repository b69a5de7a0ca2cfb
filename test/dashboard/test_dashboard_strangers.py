"""The dashboard on a graph on which strangers speak: what they say is neither run nor kept without bound."""

import contextlib
import re
import sys
import time

import pytest

pytest.importorskip("nicegui", reason="needs the extra `dashboard`")
pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")
pytest.importorskip("websockets", reason="needs websockets to drive a browser")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from headless_browser import CHROMIUM, browser
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from served import answer, own_address, running, served, until

from ehls_msgs.msg import FrictionEstimate
from ehls_ros.dashboard.words import FIGURES, NAME, SENTENCE, figures, line
from ehls_ros.nodes.dashboard_link import STRANGERS

pytestmark = pytest.mark.timeout(900)

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
"""What strangers may cost [MB]: the middleware keeps some messages of theirs."""


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_texts_of_the_graph_are_shown_and_not_run(tmp_path):
    said = [[line(text), 1, line(text), figures([(text, text)])] for text in SCRIPTS]
    with (
        served() as server,
        browser(tmp_path) as chromium,
        # One that is there before the page, and one that comes while it is open.
        chromium.tab("about:blank") as tab,
    ):
        server.tell(said)
        tab.go(server.address)
        for named in (said, [*said, ["another <b>node</b>", 2, "<b>bold</b>", {}]]):
            server.tell(named)
            tab.click("[data-name=tab-nodes]")
            tab.until(f"document.querySelectorAll('.nodes b').length === {len(named)}")
        # More updates have come since, and with them all there is to run.
        tab.until("ehlsLive.last() > 0 && document.querySelector('.trouble').innerText.includes('<b>bold</b>')")
        shown = tab.evaluate("[...document.querySelectorAll('.nodes summary > b')].map(name => name.textContent)")
        assert sorted(shown) == sorted(each[0] for each in named)
        assert tab.evaluate("window.ran ?? null") is None
        assert tab.evaluate("document.querySelectorAll('.nodes img, .nodes svg, .nodes script').length") == 0


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_machine_that_is_too_slow_is_named_before_what_comes_of_it(tmp_path):
    slow = "machine too slow: 720 cycles/s of 1000 asked"
    gate = ["plant_sim_node", 2, "tripped: command too old", {"state": "cut"}]
    with served() as server, browser(tmp_path) as chromium, chromium.tab(server.address) as tab:
        trouble = "document.querySelector('[data-name=trouble]').innerText"
        server.tell([["fasmc_node", 1, slow, {}], gate])
        tab.until(f"{trouble}.startsWith('fasmc_node: {slow}. plant_sim_node: tripped: command too old')")
        assert tab.text("state").startswith("too slow, ")
        server.tell([["fasmc_node", 1, slow, {}]])
        tab.until(f"{trouble} === 'fasmc_node: {slow}'")
        server.tell([["fasmc_node", 0, "well", {}]])
        tab.until("document.querySelector('[data-name=state]').innerText.startsWith('running, ')")
        assert not tab.text("trouble")


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_page_that_only_reads_is_whole_although_nobody_hears_it(tmp_path):
    with served() as server, browser(tmp_path) as chromium, chromium.tab(f"http://127.0.0.1:{server.port}/") as tab:
        tab.until("ehlsLive.last() > 0")
        tab.click(".pause input")
        tab.until("document.querySelector('.pause input').checked")
        tab.click("summary")
        tab.until("document.querySelector('details').open")
        # What is said now comes after the page's events: it was not cut off for them.
        server.tell([["fasmc_node", 1, "still there", {}]])
        tab.until("document.querySelector('.trouble').innerText.includes('still there')")
        assert tab.complaints == []
        assert server.wishes() == []


@pytest.mark.skipif(CHROMIUM is None or own_address() is None, reason="needs Chromium and an address besides the loopback's")
def test_a_browser_on_another_machine_shows_the_page_and_its_buttons_work(tmp_path):
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(served("0.0.0.0"))
        chromium = stack.enter_context(browser(tmp_path))
        tab = stack.enter_context(chromium.tab(f"http://{own_address()}:{server.port}/?token={server.token}"))
        tab.until("ehlsLive.last() > 0")
        tab.click("[data-name='emergency stop']")
        until(lambda: server.wishes() == ["emergency stop"], "the button does nothing")
        assert tab.complaints == []


def test_texts_are_cut_to_what_a_page_can_show():
    assert line("well") == "well"
    assert line("a\x1b[31m\nb\u202e\ud800") == "a�[31m�b��"
    assert len(line("x" * 10_000_000)) == SENTENCE + 1
    kept = figures((f"{number}{'x' * 1000}", "y" * 1000) for number in range(100_000))
    assert len(kept) == FIGURES
    assert {len(name) for name in kept} == {NAME + 1}


def status(name, message="well", values=()):
    values = [KeyValue(key=key, value=value) for key, value in values]
    return DiagnosticStatus(name=name, message=message, hardware_id="ehls", values=values)


def report(*statuses):
    array = DiagnosticArray(status=list(statuses))
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    array.header.stamp.sec, array.header.stamp.nanosec = seconds, nanoseconds
    return array


def dashboard(folder):
    """Run `ehls dashboard` where no graph is."""
    return running([sys.executable, "-m", "ehls_ros.cli.main", "dashboard", "--port", "0"], folder)


@pytest.fixture
def stranger(ros_domain_id):
    """Return a node that is no part of the graph."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain_id, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("stranger", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_whatever_strangers_publish_the_dashboard_goes_on_and_stays_small(stranger, tmp_path):
    publisher = stranger.create_publisher(DiagnosticArray, "/diagnostics", 10)
    friction = stranger.create_publisher(FrictionEstimate, "/ehls/friction_estimate", 10)
    broken = serialize_message(report(status("broken", "m" * 50)))
    with dashboard(tmp_path) as server:
        here = f"http://127.0.0.1:{server.port}/"
        names = set()
        until(lambda: publisher.get_subscription_count() == 1, "the dashboard does not listen")

        def shown():
            # Where too many pages were asked for, there is none for a while, and nothing on it.
            text = answer(f"{here}?token={server.token}")[1]
            return {name.removeprefix("node-") for name in re.findall(r'"data-name":"(node-[^"]*)"', text)}

        def until_heard(name):
            """Have a node of the graph speak until the page shows it: it is heard whatever else is said."""

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
        until(lambda: names.update(shown()) or names, "no page is given out")
        assert len(names - {"fasmc_node", "friction_estimator_node", "plant_sim_node"}) <= STRANGERS
        assert max(map(len, names)) <= 2 * NAME
        assert "long" not in names
        assert server.memory() - before < GROWTH
        assert "Traceback" not in server.said()
