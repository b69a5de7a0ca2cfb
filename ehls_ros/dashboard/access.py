"""Access control of the page: read and write permissions.

The page can stop a rig, so other web pages in the same browser and other people on the network must not reach it:

* The Host header must be one of this machine's addresses; a foreign name that resolves to this machine is refused.
* An Origin header must be the page's own.
* Changing anything needs the token printed at start-up. Reading needs it too, except over the loopback interface.
* A websocket from another machine needs the id of a served page, which only the page's receiver has.

The token stays in the page's address. A cookie would be sent to every server on this machine, whatever its port, and would give
every page of the browser the write permission of one.

The libraries behind the socket trust their input: an event for another page's button, a text for the terminal, an announced
attachment that never arrives. So each message over a socket is checked first. A read-only page may only acknowledge received
messages.
"""

import ipaddress
import secrets
import socket
from collections import deque
from collections.abc import Callable
from enum import Enum, auto
from typing import Any
from urllib.parse import parse_qs, urlsplit

import orjson
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ehls_ros.dashboard.connections import Connections

TOKEN = "token"  # noqa: S105 - its name, not the token
"""Query field of the token in the page's address."""

PAGE = "client_id"
"""Query field of the page's id in its socket's address; the id is as hard to guess as the token."""

WRITES = "writes"
"""Key in a request's state: whether the requested page may change things."""

MAX_PAGES = 16
"""Maximum number of pages open at once, for read-only pages and for pages that may write separately."""

MAX_ENDED_PAGES = 256
"""Maximum number of closed pages whose id is still accepted."""

AWAY = 30.0
"""Time without an answer from the browser after which a page is dropped [s]; a browser that returns gets a new page."""

FILES, SOCKETS, ICON = "/_nicegui/", "/_nicegui_ws/socket.io/", "/favicon.ico"
"""Paths NiceGUI serves beside the page."""

DOCUMENTS = "/documents/"
"""Path of the documents about a recording."""

MAX_MESSAGE = 64 * 1024
"""Maximum size of a message over a socket [B]; the text of a field is sent in one piece."""

_SIGNALS = {"1", "3", "40", "40{}", "41"}
"""Engine.IO and Socket.IO packets: close, pong, connect, connect, disconnect."""

_EVENT = "42"

_POLICY = {
    # Vue compiles templates in the browser and needs eval for it. Nothing may be loaded from other hosts.
    "content-security-policy": "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; form-action 'none'; base-uri 'none'",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}

_DOCUMENT_POLICY = _POLICY | {
    # A document has scripts, but no part in the page's origin.
    "content-security-policy": f"{_POLICY['content-security-policy']}; sandbox allow-scripts allow-modals allow-downloads",
}


class Verdict(Enum):
    """Treatment of a message."""

    PASSED = auto()
    DROPPED = auto()
    CUT_OFF = auto()
    """A browser running the page never sends this, so the socket is closed."""


class Access:
    """The rules of one server, and the pages it has served."""

    def __init__(self, host: str) -> None:
        """Make a token.

        Args:
            host: name or address the server is bound to.
        """
        self.token = secrets.token_urlsafe(16)
        self._host = host
        self._loopback = _is_loopback(host)
        self._pages: dict[str, bool] = {}
        self._ended: deque[str] = deque(maxlen=MAX_ENDED_PAGES)

    def refusal(self, connection: HTTPConnection) -> str:
        """Return why a request is refused; empty if it is allowed."""
        host = connection.headers.get("host", "")
        if not self._is_ours(host):
            return f"the Host header is {host!r}, which is not one of this server's addresses"
        origin = connection.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return f"the Origin header is {origin!r}, which is not this server"
        query = _query(connection)
        if TOKEN in query:
            return "" if self.may_write(connection) else "the token is not the one printed when the dashboard was started"
        local = connection.client is not None and _is_loopback(connection.client.host)
        if local or self.page_of(connection):
            return ""
        # The library's own files hold no secrets.
        if connection.scope["type"] == "http" and connection.url.path.startswith(FILES):
            return ""
        return "a token is needed: use the address printed when the dashboard was started"

    def may_write(self, connection: HTTPConnection) -> bool:
        """Return whether the requested page may change things."""
        given = _query(connection).get(TOKEN, [""])[0]
        return secrets.compare_digest(given.encode(), self.token.encode())

    def has_room(self, *, writes: bool) -> bool:
        """Return whether another page can be served; readers and writers are counted separately."""
        return sum(each == writes for each in self._pages.values()) < MAX_PAGES

    def give(self, page: str, *, writes: bool) -> None:
        """Register a served page: knowing its id permits opening its socket."""
        self._pages[page] = writes

    def end(self, page: str) -> None:
        """Register that a page has closed; its browser may reconnect to learn of it."""
        del self._pages[page]
        self._ended.append(page)

    def page_of(self, connection: HTTPConnection) -> str:
        """Return the id of the page a socket claims to belong to; empty if no such page was served."""
        page = _query(connection).get(PAGE, [""])[0]
        return page if connection.scope["type"] == "websocket" and (page in self._pages or page in self._ended) else ""

    def writes(self, page: str) -> bool:
        """Return whether a page may change things."""
        return self._pages.get(page, False)

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name == "localhost" or _is_loopback(name):
            return True
        if self._loopback:
            return False
        # A numeric address cannot be re-pointed by somebody's name server.
        return name in {self._host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()} or _is_number(name)


class AccessMiddleware:
    """Check every request and websocket against :class:`Access`, and pass on only requests that a page needs."""

    def __init__(self, app: ASGIApp, access: Access, connections: Connections) -> None:
        """Wrap the application."""
        self._app = app
        self._access = access
        self._connections = connections

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or refuse a request."""
        if scope["type"] == "http":
            with self._connections.answered(scope["client"]):
                await self._answer(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._listen(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        connection = HTTPConnection(scope)
        writes = self._access.may_write(connection)
        code, refusal = self._refusal(connection, writes=writes)
        if refusal:
            # Close at once instead of reading the rest of the request.
            await PlainTextResponse(f"{refusal}\n", code, {"connection": "close"})(scope, receive, send)
            return

        async def send_with_policy(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = Headers(raw=message["headers"]).mutablecopy()
                headers.update(_DOCUMENT_POLICY if scope["path"].startswith(DOCUMENTS) else _POLICY)
                message["headers"] = headers.raw
            await send(message)

        # The token is not passed downstream, so it cannot be logged there.
        stripped = {**scope, "query_string": b"", "state": {**scope.get("state", {}), WRITES: writes}}
        await self._app(stripped, receive, send_with_policy)

    def _refusal(self, connection: HTTPConnection, *, writes: bool) -> tuple[int, str]:
        refusal = self._access.refusal(connection)
        if refusal:
            return 403, refusal
        if connection.scope["method"] not in {"GET", "HEAD"}:
            return 405, "only GET and HEAD are answered"
        if connection.headers.get("content-length", "0") != "0" or "transfer-encoding" in connection.headers:
            return 413, "requests with a body are refused"
        path = connection.scope["path"]
        if path not in {"/", ICON} and not path.startswith((FILES, DOCUMENTS)):
            return 404, "there is no such page: the dashboard is at /"
        if path == "/" and not self._access.has_room(writes=writes):
            return 503, f"{MAX_PAGES} pages are open already: close one, and wait a minute"
        return 200, ""

    async def _listen(self, scope: Scope, receive: Receive, send: Send) -> None:
        connection = HTTPConnection(scope)
        refusal = self._access.refusal(connection)
        page = self._access.page_of(connection)
        # "sid" would continue a session begun over HTTP polling, which is not served.
        if refusal or not scope["path"].startswith(SOCKETS) or "sid" in _query(connection):
            await send({"type": "websocket.close", "code": 1008, "reason": refusal})
            return
        if page:
            self._connections.belongs(scope["client"], page)

        async def receive_permitted() -> Message:
            while (message := await receive())["type"] == "websocket.receive":
                verdict = judge_message(message.get("text"), page, writes=self._access.writes(page))
                if verdict is Verdict.PASSED:
                    break
                if verdict is Verdict.CUT_OFF:
                    await send({"type": "websocket.close", "code": 1008})
                    return {"type": "websocket.disconnect", "code": 1008}
            return message

        await self._app(scope, receive_permitted, send)


def _query(connection: HTTPConnection) -> dict[str, list[str]]:
    try:
        return parse_qs(connection.scope["query_string"].decode("latin-1"))
    except ValueError:
        # More fields than parse_qs accepts.
        return {}


def _is_number(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_loopback(name: str) -> bool:
    return name == "localhost" or (_is_number(name) and ipaddress.ip_address(name).is_loopback)


# --- messages of a socket -----------------------------------------------------------------------


def judge_message(text: str | None, page: str, *, writes: bool) -> Verdict:
    """Return the treatment of a message.

    Args:
        text: the message; None: it is binary.
        page: id of the page the socket belongs to; empty: none.
        writes: whether that page may change things.
    """
    if text in _SIGNALS:
        return Verdict.PASSED
    if text is None or not page or not text.startswith(_EVENT):
        return Verdict.CUT_OFF
    # A number before the bracket requests an acknowledgement.
    number, bracket, rest = text.removeprefix(_EVENT).partition("[")
    try:
        name, message = orjson.loads(bracket + rest)
        fits = message["client_id"] == page and (not number or (number.isdecimal() and len(number) < 10))
        known = fits and name in _CHECKS and _CHECKS[name](message)
    except (ValueError, TypeError, KeyError):
        return Verdict.CUT_OFF
    if not known:
        return Verdict.CUT_OFF
    return Verdict.PASSED if name in {"ack", "handshake"} or (name == "event" and writes) else Verdict.DROPPED


def _is_event(message: dict[str, Any]) -> bool:
    arguments = message.get("args", [])
    for argument in arguments:
        if argument is not None:
            orjson.loads(argument)
    return type(message["id"]) is int and type(message["listener_id"]) is str and type(arguments) is list


def _is_ack(message: dict[str, Any]) -> bool:
    return type(message["next_message_id"]) is int


def _is_handshake(message: dict[str, Any]) -> bool:
    names = all(type(message[name]) is str for name in ("tab_id", "document_id"))
    return names and type(message.get("old_tab_id")) in {str, type(None)} and type(message.get("next_message_id", 0)) is int


_CHECKS: dict[str, Callable[[dict[str, Any]], bool]] = {
    "event": _is_event,
    "ack": _is_ack,
    "handshake": _is_handshake,
    # Texts for the terminal and results of scripts: nothing here uses them.
    "log": lambda _: True,
    "javascript_response": lambda _: True,
}
