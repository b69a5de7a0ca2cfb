"""The web server of the dashboard."""

import signal
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from nicegui import ui

from ehls_ros.dashboard.access import TOKEN, Access, AccessMiddleware
from ehls_ros.dashboard.graph import Graph
from ehls_ros.dashboard.page import Page
from ehls_ros.errors import BadInput

AWAY = 30.0
"""Time after which a page whose browser does not answer is given up, and built anew when it does [s]."""

FAREWELL = 1
"""Time open pages are given to go when the server ends [s]."""


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Args:
        host: name or address; 127.0.0.1 is reached from this machine only.
        port: 0: any that is free.

    Raises:
        BadInput: the address cannot be had.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise BadInput(f"port {port} of {host} cannot be had ({error.strerror})", "command line", "--port 0, for any") from None


def serve(graph: Graph, opened: socket.socket, spec: Path | None, up: Callable[[str], None]) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        graph: the graph it shows.
        opened: listening socket; it is closed at the end.
        spec: experiment file that is offered first.
        up: called with the page's address, token included, once it can be opened.
    """
    host, port = opened.getsockname()[:2]
    access = Access(host)
    shown = f"[{host}]" if ":" in host else host

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        up(f"http://{shown}:{port}/?{TOKEN}={access.token}")
        yield
        graph.give_up()

    app = FastAPI(openapi_url=None, lifespan=lifespan)

    @ui.page("/", title="EHLS dashboard", dark=None)
    def _index(request: Request) -> None:
        Page(graph, spec, writes=access.may_write(request))

    ui.run_with(app, tailwind=False, show_welcome_message=False, binding_refresh_interval=None, reconnect_timeout=AWAY)
    app.add_middleware(AccessMiddleware, access=access)
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=FAREWELL)
    # uvicorn hands a signal on, once it has ended, to whoever had it before.
    before = {number: signal.signal(number, lambda *_: None) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        uvicorn.Server(config).run(sockets=[opened])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
