"""The dashboard in a browser, on a graph it started itself."""

import contextlib
import json
import os
import time
from pathlib import Path

import pytest
import yaml

pytest.importorskip("nicegui", reason="needs the extra `dashboard`")
pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")
pytest.importorskip("websockets", reason="needs websockets to drive a browser")

import rclpy
import websockets.exceptions
from headless_browser import CHROMIUM, browser
from patience import PATIENCE
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from served import answer, dashboard, served
from websockets.sync.client import connect

from ehls_ros.cli.main import main
from ehls_ros.experiments.spec import load_spec
from ehls_ros.recording.bag_reader import read_bag

pytestmark = [pytest.mark.long, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]

RIG = Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml"

ASK_AGAIN = 1.0
"""Time after which an unanswered request is repeated [s]."""

SPEC = f"""
title: gentle
rig: {RIG}
# Few cycles per second, so that a slow machine has time for the browser.
control_period: 5.0e-3
reference: {{name: sine, amplitude: 1.0e+3, frequency: 0.5}}
controller: fasmc
"""


@pytest.fixture(scope="module")
def domain(pytestconfig, domains_used, nothing_left_behind):
    """Return a domain for this file's graph."""
    common = next(plugin for plugin in pytestconfig.pluginmanager.get_plugins() if hasattr(plugin, "reserve_domain"))
    number, lock = common.reserve_domain()
    with lock:
        domains_used.add(number)
        yield number


@pytest.fixture(scope="module")
def shown(domain, one_realtime_graph_in_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dashboard")
    (folder / "gentle.yaml").write_text(SPEC, encoding="utf-8")
    with dashboard(folder, domain, "--spec", "gentle.yaml") as started:
        yield started


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("chromium")) as started:
        yield started


@pytest.fixture(scope="module")
def tab(shown, chromium):
    """Return a page that may write, with a running graph."""
    with chromium.tab(shown.address) as page:
        page.resize(1366, 768)
        page.until("document.querySelector('[data-name=state]')?.innerText.includes('cycles/s')")
        page.until("!!document.querySelector('[data-name=value-k]')")
        yield page


@pytest.fixture
def parameter(domain):
    """Return a function that reads a parameter of the controller without the dashboard."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("asker", context=context, namespace="ehls")
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    client = node.create_client(GetParameters, "fasmc_node/get_parameters")

    def ask(name: str) -> float:
        asked, deadline = [], time.monotonic() + PATIENCE
        # DDS may lose an answer to a client that it has just found.
        while not any(future.done() for future in asked):
            assert time.monotonic() < deadline, "the controller does not answer"
            assert client.wait_for_service(PATIENCE)
            asked.append(client.call_async(GetParameters.Request(names=[name])))
            executor.spin_until_future_complete(asked[-1], ASK_AGAIN)
        return next(future.result() for future in asked if future.done()).values[0].double_value

    yield ask
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)


AXES = "document.querySelectorAll('.plot .nicegui-echart')[{}].id"


def goes_on(page):
    page.until(f"ehlsLive.last() > {page.evaluate('ehlsLive.last()')} + 10")


def test_the_page_moves_and_asks_no_other_server(tab, shown):
    picture = "document.querySelector('.plot canvas').toDataURL()"
    tab.evaluate(f"window.before = {picture}")
    tab.until(f"{picture} !== window.before")
    goes_on(tab)
    assert tab.evaluate("document.querySelector('[data-name=beginning]').offsetParent") is None
    # A busy machine may lose the messages of an interval.
    newest = "['force_n', 'supply_pressure_pa'].map(ehlsLive.newest)"
    force, supply = tab.until(f"(values => values.every(value => value !== null) && values)({newest})")
    assert abs(force) < 2e4
    assert supply == pytest.approx(7e6, rel=0.1)
    server = shown.server.removeprefix("http://")
    assert {address.partition("://")[2].partition("/")[0] + "/" for address in tab.requested if ":" in address} <= {server}
    assert tab.complaints == []


FAILS_LATER = """
import os, pathlib, sys, time
if "ehls_ros.nodes.plant_sim_node" in sys.orig_argv:
    while not pathlib.Path("go").exists():
        time.sleep(0.05)
    print("out of oil", file=sys.stderr, flush=True)
    os._exit(2)
"""


def test_a_page_shows_the_progress_of_the_nodes_and_why_one_died(tab, shown, chromium, domain, tmp_path):
    (tmp_path / "gentle.yaml").write_text(SPEC, encoding="utf-8")
    (tmp_path / "sitecustomize.py").write_text(FAILS_LATER, encoding="utf-8")
    path = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    with (
        dashboard(tmp_path, domain, "--spec", "gentle.yaml", "--namespace", "rig2", PYTHONPATH=path) as started,
        chromium.tab(started.address) as page,
    ):
        said = "document.querySelector('[data-name=beginning]').innerText.replace(/\\s+/g, ' ')"
        page.until(f"{said}.includes('fasmc_node ready')")
        assert page.evaluate(said).startswith("Starting the graph: ")
        assert "plant_sim_node starting" in page.evaluate(said)
        assert page.text("state").startswith("starting, ")
        assert page.text("where") == f"/rig2 in ROS domain {domain}"
        with chromium.tab(shown.server) as other:
            other.until("document.querySelectorAll('.nodes b').length === 5")
            assert "rig2" not in other.evaluate("document.querySelector('.nodes').innerText")
        (tmp_path / "go").touch()
        page.until("document.querySelector('[data-name=trouble]').innerText.startsWith('plant_sim_node died: out of oil')")
        page.until(f"{said}.startsWith('No graph is running')")
        page.until("document.querySelector('[data-name=state]').innerText === 'no graph'")
        page.click("[data-name=tab-nodes]")
        page.until("document.querySelector('.side').innerText.includes('No node publishes diagnostics.')")
        page.click("[data-name=tab-experiment]")
        page.until("document.querySelector('[data-name=start]')?.disabled === false")


def test_an_invalid_namespace_is_refused(capsys):
    assert main(["dashboard", "--port", "0", "--namespace", "rig 2"]) == 2
    complaint = capsys.readouterr().err
    assert "'rig 2'" in complaint
    assert "such as rig2" in complaint


def test_nothing_is_cut_off_at_the_size_of_a_laptop(tab):
    assert tab.evaluate("document.documentElement.scrollHeight <= 768 && document.documentElement.scrollWidth <= 1366")
    boxes = tab.evaluate(
        "[...document.querySelectorAll('.plot')].map(p => { const b = p.getBoundingClientRect();"
        "return [b.left, b.top, b.right, b.bottom]; })"
    )
    assert len(boxes) == 10
    for i, (left, top, right, bottom) in enumerate(boxes):
        assert 0 <= left < right <= 1366
        assert 0 <= top < bottom <= 768
        for other in boxes[i + 1 :]:
            assert right <= other[0] or other[2] <= left or bottom <= other[1] or other[3] <= top
    assert tab.evaluate("[...document.querySelectorAll('.plot header')].every(h => h.scrollWidth <= h.clientWidth)")


def test_a_slider_changes_the_parameter_in_the_node(tab, parameter):
    before = parameter("k")
    tab.press("[data-name=slider-k] [tabindex]", "ArrowRight")
    tab.until(f"Number(document.querySelector('[data-name=value-k]').value) > {before}")
    tab.is_told("k is ")
    assert parameter("k") == pytest.approx(tab.evaluate("Number(document.querySelector('[data-name=value-k]').value)"))


def test_a_value_out_of_range_shows_the_reason_of_the_node(tab, parameter):
    before = parameter("g")
    tab.type_into("[data-name=value-g]", "1e9")
    tab.until("document.querySelector('[data-name=refused-g]').innerText.includes('less than or equal to')")
    assert parameter("g") == before
    tab.type_into("[data-name=value-g]", "61")
    tab.until("document.querySelector('[data-name=refused-g]').offsetParent === null")
    assert parameter("g") == 61.0
    goes_on(tab)


STATE = "document.querySelector('[data-name=state]').innerText"


def visible(name):
    return f"document.querySelector('[data-name=\"{name}\"]').offsetParent !== null"


def test_an_emergency_stop_says_what_to_press_and_the_buttons_lead_on(tab):
    assert not tab.evaluate(visible("acknowledge stop"))
    tab.click("[data-name='emergency stop']")
    tab.is_told("emergency stop stop-1: the valve is closed")
    tab.until(f"{STATE}.startsWith('stopped, valve closed')")
    assert "To go on: Acknowledge stop, then Reset and enable." in tab.text("trouble")
    for name, reached in (("acknowledge stop", "tripped"), ("reset and enable", "running")):
        tab.until(visible(name))
        # A stop lasts at least a second, and on a busy machine the gate may find its command too old: then click again.
        button = f"document.querySelector(\"[data-name='{name}']\")"
        click = f"Date.now() - (window.asked ??= 0) > 1000 && ({button}.click(), window.asked = Date.now())"
        tab.until(f"({click}, {STATE}.startsWith('{reached}'))")
    assert not tab.evaluate(visible("reset and enable"))


def test_a_line_keeps_its_signal_when_the_signals_data_come_one_after_the_other(chromium):
    with served() as server, chromium.tab(server.address) as page:
        page.until("ehlsLive?.shown('Force').length === 2")
        page.evaluate("void window.socket.disconnect()")
        series = f"getElement({AXES.format(0)}.slice(1)).chart.getOption().series.filter(Boolean)"
        for lines, signals in enumerate((["position_m"], ["force_n"], ["force_reference_n", "force_n"])):
            part = json.dumps({name: [{"force_n": 1e3, "force_reference_n": 2e3}.get(name, 0.0)] * 10 for name in signals})
            more = f"ehlsLive.extend({{era: {-1 - lines}, first: ehlsLive.last(), low: {part}, high: {part}}})"
            page.until(f"({more}, {series}.length === {lines} && {series}.every(one => one.data.length))")
        drawn = dict(page.evaluate(f"{series}.map(one => [one.name, one.data[1]])"))
        assert drawn == {"force": 1.0, "reference": 2.0}


def chosen(page, name, value):
    page.evaluate(f"(s => {{ s.value = '{value}'; s.onchange(); }})(document.querySelector('select[name=\"{name}\"]'))")


def axis(page, number):
    """Return unit and time span of a plot."""
    chart = f"getElement({AXES.format(number)}.slice(1)).chart.getOption()"
    return page.evaluate(f"[{chart}.yAxis[0].name, {chart}.xAxis[0].min]")


def test_signals_units_and_time_are_chosen_and_remembered_without_the_token_too(shown, chromium):
    with chromium.tab(shown.server) as page:
        page.until("document.querySelector('[data-name=state]')?.innerText.includes('cycles/s')")
        page.until("ehlsLive.shown('Friction elements').length > 1")
        assert page.evaluate("ehlsLive.shown('Friction elements')") == ["viscous", "1", "2", "3"]
        page.until("!!document.querySelector('select[name=pressure]')")
        chosen(page, "pressure", "bar")
        chosen(page, "time shown", "30")
        # Another force is added to the forces; a velocity takes their place.
        page.click(".plot .choices input[name=friction_viscous_n]")
        assert page.evaluate("ehlsLive.shown('Force')") == ["force", "reference", "viscous"]
        page.click(".plot .choices input[name=velocity_m_s]")
        page.go(shown.server)
        page.until("typeof ehlsLive !== 'undefined' && ehlsLive.shown('Force').length > 0")
        assert page.evaluate("ehlsLive.shown('Force')") == ["velocity"]
        page.until("document.querySelector('.plot b').innerText === 'piston velocity'")
        assert (axis(page, 0), axis(page, 2)) == (["mm/s", -30], ["bar", -30])
        page.evaluate('localStorage.setItem(\'ehls-view\', \'{"span": 1, "units": {"N": "oz"}, "shown": {"Force": ["x"]}}\')')
        page.go(shown.server)
        page.until("typeof ehlsLive !== 'undefined' && ehlsLive.shown('Force').length === 2")
        assert axis(page, 0) == ["kN", -10]
        assert page.complaints == []


@pytest.mark.parametrize("width", [1366, 390])
def test_nothing_is_wider_than_the_screen(tab, width):
    tab.resize(width, 768)
    tab.evaluate("document.querySelectorAll('.menu').forEach(menu => (menu.open = true))")
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    tab.evaluate("document.querySelectorAll('.menu').forEach(menu => (menu.open = false))")
    tab.resize(1366, 768)


def test_a_page_without_the_token_shows_but_cannot_write(tab, shown, chromium):
    with chromium.tab(shown.server) as reader:
        reader.until("document.querySelector('[data-name=state]')?.innerText.includes('cycles/s')")
        goes_on(reader)
        assert reader.text("read-only")
        assert reader.evaluate("document.querySelectorAll('.q-btn, .side input').length") == 0
        # Send the message of the other page's button from here.
        button = tab.evaluate("document.querySelector(\"[data-name='emergency stop']\").id.slice(1)")
        listener = tab.evaluate(f"mounted_app.elements[{button}].events.find(e => e.type === 'click').listener_id")
        event = {"id": int(button), "listener_id": listener, "args": ["{}"]}
        reader.evaluate(f"void window.socket.emit('event', {{...{json.dumps(event)}, client_id: window.clientId}})")
        goes_on(reader)
        goes_on(tab)
        assert "emergency stop" not in tab.text("trouble")


def refused(address, **headers):
    code, text = answer(address, **headers)
    assert code == 403
    return text


def test_wrong_tokens_hosts_and_origins_are_refused(shown):
    assert "token" in refused(f"{shown.server}?token=guessed")
    assert "Host" in refused(shown.address, Host="rebound.example")
    assert "Origin" in refused(shown.address, Origin="http://elsewhere.example")
    socket = shown.server.replace("http", "ws", 1) + "_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    with pytest.raises(websockets.exceptions.InvalidStatus) as caught:
        connect(socket, origin="http://elsewhere.example")
    assert caught.value.response.status_code == 403
    with connect(socket, origin=shown.server.rstrip("/"), open_timeout=PATIENCE) as opened:
        assert opened.recv(timeout=PATIENCE).startswith("0")


def test_a_recording_holds_the_signals(tab, shown):
    tab.click("[data-name=tab-experiment]")
    tab.until("document.querySelector('[data-name=record]')?.disabled === false")
    tab.click("[data-name=record]")
    tab.is_told("Recording to ")
    tab.click("[data-name=tab-nodes]")
    tab.until(
        "[...document.querySelectorAll('[data-name=node-recorder_node] dt')]"
        ".some(name => name.textContent === 'cycles' && Number(name.nextElementSibling.textContent) > 100)"
    )
    tab.click("[data-name=tab-experiment]")
    tab.click("[data-name=record]")
    tab.until("document.querySelector('[data-name=activity]').innerText.includes('Recorded: ')")
    [bag] = shown.folder.glob("runs/*-recording-*/bag")
    trajectory = read_bag(bag)
    assert len(trajectory["force_n"]) > 100


def test_a_graph_is_stopped_and_started_again_with_a_hidden_effect(tab, shown):
    tab.click("[data-name=tab-experiment]")
    tab.until("document.querySelector('[data-name=stop]')?.disabled === false")
    tab.click("[data-name=stop]")
    tab.until("document.querySelector('[data-name=state]').innerText === 'graph gone'")
    tab.until("document.querySelector('[data-name=trouble]').innerText.includes('No more snapshots')")
    tab.choose("[data-name=effect]", "dead zone")
    tab.type_into("[data-name=effect-positive]", "2e-4")
    tab.click("[data-name='add effect']")
    tab.until("document.querySelector('.q-chip')?.innerText.includes('valve dead zone')")
    tab.until("document.querySelector('[data-name=start]').disabled === false")
    tab.click("[data-name=start]")
    tab.until("document.querySelector('[data-name=state]').innerText.includes('cycles/s')")
    goes_on(tab)
    newest = max(shown.folder.glob("runs/gentle-*/spec.yaml"), key=lambda path: path.stat().st_mtime)
    spec = load_spec(newest)
    [effect] = spec.rig.effects
    assert (effect.name, effect.parameters.positive) == ("valve_dead_zone", 2e-4)
    assert spec.controller_rig.effects == ()
    assert yaml.safe_load(newest.read_text(encoding="utf-8"))["title"] == "gentle"


def test_a_second_dashboard_joins_leaves_the_graph_alone_and_says_when_its_server_is_gone(
    tab, shown, chromium, domain, tmp_path
):
    with contextlib.ExitStack() as stack:
        with dashboard(tmp_path, domain) as second:
            page = stack.enter_context(chromium.tab(second.address))
            page.until("document.querySelector('[data-name=state]')?.innerText.includes('cycles/s')")
            goes_on(page)
            page.click("[data-name=tab-experiment]")
            page.until("document.querySelector('[data-name=stop]')?.disabled")
            assert page.evaluate("document.querySelector('[data-name=start]').disabled")
        page.until("document.body.classList.contains('cut-off')")
        assert page.evaluate("document.querySelector('.lost').offsetParent !== null")
        goes_on(tab)
