"""The web server of the dashboard."""

import asyncio
import logging
import signal
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from nicegui import app as library
from nicegui import ui
from starlette.responses import FileResponse, PlainTextResponse, Response

from ehls_ros.dashboard.access import AWAY, DOCUMENTS, MAX_MESSAGE, TOKEN, WRITES, Access, AccessMiddleware
from ehls_ros.dashboard.connections import MAX_HEAD, Connections
from ehls_ros.dashboard.graph import Graph, Timing
from ehls_ros.dashboard.page import Page
from ehls_ros.errors import BadInput

FAREWELL = 1
"""Time for open pages to close when the server stops [s]."""


def listening(host: str, port: int) -> socket.socket:
    """Return a listening socket.

    Args:
        host: name or address; 127.0.0.1 is reachable from this machine only.
        port: port number; 0: any free one.

    Raises:
        BadInput: the address cannot be opened.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        place = f"port {port} of {host} cannot be opened ({error.strerror})"
        raise BadInput(place, "command line", "--port 0, for any free port") from None


def serve(graph: Graph, opened: socket.socket, spec: Path | None, timing: Timing, up: Callable[[str], None]) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        graph: the graph shown.
        opened: listening socket; closed at the end.
        spec: experiment file preselected for Start.
        timing: preselected for Start.
        up: called with the page's address, including the token, once it can be opened.
    """
    host, port = opened.getsockname()[:2]
    access, connections = Access(host), Connections()
    shown = f"[{host}]" if ":" in host else host

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        cutting = asyncio.create_task(connections.cut_slow())
        up(f"http://{shown}:{port}/?{TOKEN}={access.token}")
        yield
        cutting.cancel()
        graph.abort()

    app = FastAPI(openapi_url=None, lifespan=lifespan)

    @ui.page("/", title="EHLS dashboard", dark=None)
    def _index(request: Request) -> None:
        client, writes = ui.context.client, getattr(request.state, WRITES)
        access.give(client.id, writes=writes)
        client.on_delete(lambda: access.end(client.id))
        Page(graph, spec, timing, writes=writes)

    @app.get(f"{DOCUMENTS}{{name}}")
    def _document(name: str) -> Response:
        document = graph.document(name)
        if document is None:
            return PlainTextResponse("there is no such document\n", 404)
        # A browser shows YAML only as plain text.
        return FileResponse(document, media_type="text/plain" if document.suffix == ".yaml" else None)

    _quieten()
    ui.run_with(app, tailwind=False, show_welcome_message=False, binding_refresh_interval=None, reconnect_timeout=AWAY)
    app.add_middleware(AccessMiddleware, access=access, connections=connections)
    config = uvicorn.Config(
        app,
        http=connections.protocol(),
        h11_max_incomplete_event_size=MAX_HEAD,
        ws_max_size=MAX_MESSAGE,
        # A compressed message could expand without limit, and compression would cost more than it saves here.
        ws_per_message_deflate=False,
        # The peer is the connection's address, not the one claimed in a header.
        proxy_headers=False,
        log_level="error",
        access_log=False,
        timeout_graceful_shutdown=FAREWELL,
    )
    # After stopping, uvicorn raises the signal again for the previous handler.
    before = {number: signal.signal(number, lambda *_: None) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        uvicorn.Server(config).run(sockets=[opened])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _quieten() -> None:
    """Suppress log output caused by clients, and the building of a page for every unknown address."""
    library.add_exception_handler(404, lambda *_: PlainTextResponse("there is no such file\n", 404))
    for name in ("engineio.server", "socketio.server"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
