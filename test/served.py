"""The dashboard's server in a separate process, and clients to reach it."""

import contextlib
import html
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import psutil
from patience import PATIENCE
from websockets.sync.client import ClientConnection, connect

STAND_IN = Path(__file__).parent / "dashboard" / "stand_in.py"


class Served:
    """A running server.

    Attributes:
        address: the page's address with the token.
        server: the same without the token.
        folder: its working folder.
        lines: its output after the address.
    """

    def __init__(self, process: subprocess.Popen[str], folder: Path | None) -> None:
        self.process, self.folder = process, folder
        self.lines: list[str] = []
        self.reader = threading.Thread(target=lambda: self.lines.extend(process.stdout))
        self.reader.start()
        # The middleware may complain before the server prints its address.
        until(lambda: self._announced() or not self.reader.is_alive(), "the server printed no address")
        announced = self._announced()
        assert announced, self.said()
        del self.lines[: self.lines.index(announced) + 1]
        self.address = announced.strip()
        self.port = int(self.address.split(":")[2].split("/")[0])
        self.server, _, self.token = self.address.partition("?token=")

    def _announced(self) -> str:
        return next((line for line in self.lines if line.startswith("http://")), "")

    def requests(self) -> list[str]:
        """Return the requests that reached the stand-in graph."""
        return [line.strip().removeprefix("request: ") for line in self.lines if line.startswith("request: ")]

    def said(self) -> str:
        """Return its other output."""
        return "".join(line for line in self.lines if not line.startswith("request: "))

    def tell(self, health: list[Any] | dict[str, Any]) -> None:
        """Set the diagnostics of the stand-in graph, [node, level, message, figures] each, or its monitor's report."""
        self.process.stdin.write(json.dumps(health) + "\n")
        self.process.stdin.flush()

    def memory(self) -> float:
        """Return its resident memory [MB]."""
        return psutil.Process(self.process.pid).memory_info().rss / 1e6

    def held(self) -> int:
        """Return the number of its open connections."""
        connections = psutil.Process(self.process.pid).net_connections("tcp")
        return sum(each.status == psutil.CONN_ESTABLISHED for each in connections)


@contextlib.contextmanager
def running(command: Sequence[str], folder: Path | None = None, environment: dict[str, str] | None = None) -> Iterator[Served]:
    """Run a server; it must exit with code 0 after Ctrl-C."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command, cwd=folder, env=environment, text=True, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT
    )
    server = None
    try:
        server = Served(process, folder)
        yield server
    finally:
        process.send_signal(signal.SIGINT)
        try:
            code = process.wait(PATIENCE)
        finally:
            process.kill()
            if server is not None:
                server.reader.join()
            process.stdin.close()
            process.stdout.close()
    assert code == 0


def served(host: str = "127.0.0.1") -> contextlib.AbstractContextManager[Served]:
    """Run the server on the stand-in graph."""
    return running([sys.executable, str(STAND_IN), host])


def dashboard(folder: Path, domain: int, *arguments: str, **variables: str) -> contextlib.AbstractContextManager[Served]:
    """Run `ehls dashboard`."""
    command = [sys.executable, "-m", "ehls_ros.cli.main", "dashboard", "--port", "0", *arguments]
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"} | variables
    return running(command, folder, environment)


def until(true: Callable[[], Any], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


def answer(address: str, **headers: str) -> tuple[int, str]:
    """Return code and text of an answer."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=PATIENCE) as came:
            return came.status, came.read().decode(errors="replace")
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode(errors="replace")


def own_address() -> str | None:
    """Return a non-loopback address of this machine, if it has one; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        probe.connect(("192.0.2.1", 9))
        name = str(probe.getsockname()[0])
        return None if name.startswith("127.") else name
    return None


class Got(NamedTuple):
    """A page as received, and its id."""

    number: str
    text: str

    def listeners(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield each element's name and the message of an event on it."""
        elements = json.loads(html.unescape(re.search(r"String\.raw`(\{.*?\})`", self.text, re.DOTALL)[1]))
        for number, element in elements.items():
            for event in element.get("events", []):
                sent = {"id": int(number), "client_id": self.number, "listener_id": event["listener_id"], "args": ["{}"]}
                yield element.get("props", {}).get("data-name", ""), sent

    def click(self, name: str) -> dict[str, Any]:
        """Return the message of a click on an element."""
        return next(sent for element, sent in self.listeners() if element == name)


def page(server: str, token: str = "") -> Got:
    code, text = answer(f"{server}?token={token}" if token else server)
    assert code == 200, text
    return Got(re.search(r"'client_id': '([0-9a-f-]+)'", text)[1], text)


def event(name: str, message: Any) -> str:
    """Return an event in Socket.IO's format."""
    return f"42{json.dumps([name, message])}"


def begin(socket: ClientConnection) -> ClientConnection:
    """Open the Socket.IO session, and with it the page."""
    assert socket.recv(timeout=PATIENCE).startswith("0")
    socket.send("40")
    hear(socket, "40")
    return socket


def hear(socket: ClientConnection, beginning: str) -> None:
    """Receive messages until one has the given beginning; an open page also sends others."""
    while not (message := socket.recv(timeout=PATIENCE)).startswith(beginning):
        assert not message.startswith("44"), message


def open_socket(server: str, number: str, **more: str) -> ClientConnection:
    """Open a page's socket as its browser does."""
    query = {"EIO": "4", "transport": "websocket", "client_id": number, "implicit_handshake": "true"}
    query |= {"tab_id": f"tab of {number}", "document_id": f"document of {number}", "next_message_id": "0"} | more
    address = server.replace("http", "ws", 1) + "_nicegui_ws/socket.io/?" + urllib.parse.urlencode(query)
    return connect(address, open_timeout=PATIENCE, ping_interval=None, max_size=None, max_queue=None)
