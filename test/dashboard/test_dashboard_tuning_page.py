"""The tuning on the dashboard's page: who may press what, and what is shown."""

import contextlib
import json
import sys

import psutil
import pytest

pytest.importorskip("nicegui", reason="needs the extra `dashboard`")
pytest.importorskip("websockets", reason="needs websockets to speak to the server")

import websockets.exceptions
from headless_browser import CHROMIUM, browser
from served import begin, event, open_socket, page, running, served, until
from tunings import SCRIPT, TUNING

from ehls_ros.dashboard.graph import TUNING_DOCUMENTS
from ehls_ros.experiments.json_document import json_document

BUTTONS = ("tune", "cancel tuning", "apply-tuning")


@pytest.fixture(scope="module")
def server(nothing_left_behind):
    with served() as started:
        yield started


def tell(server, *, on_rig=False, laws=("fasmc",), tuning=TUNING):
    server.lines.clear()
    server.tell({"snapshot": {"on_rig": on_rig, "laws": list(laws), "tuning": json_document(tuning)}})


@contextlib.contextmanager
def opened(server):
    """Open a page that may write, and yield a function that clicks a button or sets a box."""
    got = page(server.server, server.token)
    with open_socket(server.server, got.number) as socket:
        begin(socket)
        yield lambda name, *arguments: socket.send(event("event", got.click(name) | {"args": list(map(json.dumps, arguments))}))


def clicked_until(server, click, request, name):
    """Click a button, which is updated twice a second, until its request arrives."""

    def arrived():
        click(name, {})
        return request in server.requests()

    until(arrived, f"{name} does nothing")


def test_only_a_page_with_the_token_has_the_buttons(server):
    names = {name for name, _ in page(server.server, server.token).listeners()}
    assert names >= set(BUTTONS)
    assert not {name for name, _ in page(server.server).listeners()} & {*BUTTONS, "tuning-on-rig"}


def test_a_reader_that_forges_the_buttons_is_not_heard(server):
    tell(server)
    writer, reader = page(server.server, server.token), page(server.server)
    for name in BUTTONS:
        for forged in (writer.click(name), writer.click(name) | {"client_id": reader.number}):
            with (
                open_socket(server.server, reader.number) as socket,
                contextlib.suppress(websockets.exceptions.ConnectionClosed),
            ):
                begin(socket).send(event("event", forged))
    with opened(server) as click:
        clicked_until(server, click, "enable", "enable")
    assert set(server.requests()) == {"enable"}


def test_the_buttons_begin_and_cancel(server):
    tell(server, tuning=None)
    with opened(server) as click:
        clicked_until(server, click, "tune", "tune")
        tell(server, tuning=TUNING._replace(running=True, result=None))
        clicked_until(server, click, "cancel tuning", "cancel tuning")


def test_a_law_without_numbers_is_not_tuned(server):
    tell(server, laws=("pid",))
    with opened(server) as click:
        # Both are answered in order: by the second, the first has been ignored.
        for _ in range(3):
            click("tune", {})
            clicked_until(server, click, "enable", "enable")
    assert "tune" not in server.requests()


def test_numbers_are_applied_when_pressed_to_a_simulated_rig(server):
    tell(server)
    with opened(server) as click:
        clicked_until(server, click, "enable", "enable")
        assert set(server.requests()) == {"enable"}
        clicked_until(server, click, "apply runs/sine-tuning", "apply-tuning")


def test_on_a_real_rig_numbers_are_applied_only_once_the_operator_has_consented(server):
    tell(server, on_rig=True)
    with opened(server) as click:
        for _ in range(3):
            click("apply-tuning", {})
            clicked_until(server, click, "enable", "enable")
        assert set(server.requests()) == {"enable"}
        click("tuning-on-rig", True)
        clicked_until(server, click, "apply runs/sine-tuning to a rig", "apply-tuning")
        server.lines.clear()
        # The consent is for once.
        for _ in range(3):
            click("apply-tuning", {})
            clicked_until(server, click, "enable", "enable")
        assert set(server.requests()) == {"enable"}


def test_ctrl_c_ends_a_tuning_and_leaves_none_of_its_files(tmp_path):
    pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")
    with running([sys.executable, "-m", "ehls_ros.cli.main", "dashboard", "--port", "0"], tmp_path) as started:

        def tunings():
            children = psutil.Process(started.process.pid).children()
            return [child for child in children if any("tuning_process" in word for word in child.cmdline())]

        with opened(started) as click:
            # Without a graph, it is for the experiment chosen on the page.
            click("tune", {})
            until(tunings, "no tuning begins")
        [tuning] = tunings()
        [folder] = (tmp_path / "runs").iterdir()
        assert folder.name.startswith("sine_fd2-tuning-")
    assert not tuning.is_running()
    assert not folder.exists()


@pytest.mark.long
def test_the_page_shows_the_result_and_runs_none_of_its_texts(server, nothing_left_behind, tmp_path):
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    tell(server, tuning=None)
    with browser(tmp_path) as chromium, chromium.tab(server.address) as tab:
        tab.resize(1366, 768)
        tab.until("document.querySelector('[data-name=tuning-state]')?.innerText.includes('numbers of fasmc in simulation')")
        assert tab.evaluate("document.querySelector('[data-name=apply-tuning]').offsetParent") is None
        tell(server, tuning=TUNING._replace(running=True, result=None))
        tab.until("document.querySelector('.tuned progress')?.value === 55")
        tell(server, on_rig=True)
        tab.until("document.querySelectorAll('.tuned svg text').length > 5")
        assert SCRIPT in tab.text("tuning-sentence")
        assert SCRIPT in tab.evaluate("document.querySelector('.tuned li').textContent")
        for name in TUNING_DOCUMENTS:
            assert tab.evaluate(f"!!document.querySelector('[data-name=document-{name}]')")
        assert tab.evaluate("document.querySelector('[data-name=apply-tuning]').disabled")
        tab.click("[data-name=tuning-on-rig]")
        tab.until("document.querySelector('[data-name=apply-tuning]').disabled === false")
        tab.click("[data-name=apply-tuning]")
        until(lambda: "apply runs/sine-tuning to a rig" in server.requests(), "the button does nothing")
        for width in (1366, 390):
            tab.resize(width, 768)
            assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
        tell(server, laws=("pid",), tuning=None)
        tab.until("document.querySelector('[data-name=tuning-state]').innerText.includes('pid has no numbers to tune')")
        assert tab.evaluate("document.querySelector('[data-name=tune]').disabled")
        assert tab.evaluate("window.ran ?? null") is None
        assert tab.complaints == []
