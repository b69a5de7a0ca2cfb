"""Who may see the page and who may change things.

The page can stop a rig, so that other web pages in the same browser and other people on the same net must not reach
it: the Host header has to be one of this machine's own addresses (a name of someone else's that was made to point here
is not), an Origin header has to be the page's own, and whoever wants to change something needs the token that was
printed at the start. Over the loopback interface reading needs no token. A socket from elsewhere needs the number of a page
that was given out, which only who was allowed to have the page knows.

The token stays in the page's address. In a cookie it would be sent to every server on this machine whatever its port, and one
page that may write would make every page of the browser one.
"""

import ipaddress
import secrets
import socket
from collections import deque
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ehls_ros.dashboard.connections import Connections
from ehls_ros.dashboard.messages import Verdict, judge

TOKEN = "token"  # noqa: S105 - its name, not the token
"""Name of the token in the page's address."""

PAGE = "client_id"
"""Name of a page's number in the address of its socket; it is as hard to guess as the token."""

WRITES = "writes"
"""Name of what a request's state says: whether the page asked for may change things."""

PAGES = 16
"""Pages that read, and as many that write, at most."""

REMEMBERED = 256
"""Pages that have ended and whose number is still known."""

AWAY = 30.0
"""Time after which a page whose browser does not answer is given up, and built anew when it does [s]."""

FILES, SOCKETS, ICON = "/_nicegui/", "/_nicegui_ws/socket.io/", "/favicon.ico"
"""What the library serves beside the page."""

_POLICY = {
    # Vue compiles templates in the browser, for which it needs eval; nothing may come from elsewhere.
    "content-security-policy": "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; form-action 'none'; base-uri 'none'",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}


class Access:
    """The rules of one server, and the pages it has given out."""

    def __init__(self, host: str) -> None:
        """Make a token.

        Args:
            host: name or address the server is bound to.
        """
        self.token = secrets.token_urlsafe(16)
        self._host = host
        self._loopback = _is_loopback(host)
        self._pages: dict[str, bool] = {}
        self._ended: deque[str] = deque(maxlen=REMEMBERED)

    def refusal(self, connection: HTTPConnection) -> str:
        """Return why a request is not answered, or nothing."""
        host = connection.headers.get("host", "")
        if not self._is_ours(host):
            return f"the Host header is {host!r}, which is none of this server's addresses"
        origin = connection.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return f"the Origin header is {origin!r}, which is not this server's"
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
        """Tell whether a page that is asked for may change things."""
        given = _query(connection).get(TOKEN, [""])[0]
        return secrets.compare_digest(given.encode(), self.token.encode())

    def has_room(self, *, writes: bool) -> bool:
        """Tell whether one more page can be given out; those who may write do not wait for those who read."""
        return sum(each == writes for each in self._pages.values()) < PAGES

    def give(self, page: str, *, writes: bool) -> None:
        """Take note of a page that is given out: who knows its number may open its socket."""
        self._pages[page] = writes

    def end(self, page: str) -> None:
        """Take note that a page has ended; its browser may come back to be told so."""
        del self._pages[page]
        self._ended.append(page)

    def page_of(self, connection: HTTPConnection) -> str:
        """Return the number of the page that a socket says it belongs to, if it was given out; or nothing."""
        page = _query(connection).get(PAGE, [""])[0]
        return page if connection.scope["type"] == "websocket" and (page in self._pages or page in self._ended) else ""

    def writes(self, page: str) -> bool:
        """Tell whether a page may change things."""
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
        # An address that is a number cannot be made to point elsewhere.
        return name in {self._host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()} or _is_number(name)


class AccessMiddleware:
    """Asks :class:`Access` before every request and every websocket, and lets through only what a page needs."""

    def __init__(self, app: ASGIApp, access: Access, connections: Connections) -> None:
        """Wrap an application."""
        self._app = app
        self._access = access
        self._connections = connections

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse."""
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
            # What else the sender has for us is not waited for.
            await PlainTextResponse(f"{refusal}\n", code, {"connection": "close"})(scope, receive, send)
            return

        async def send_with_policy(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = Headers(raw=message["headers"]).mutablecopy()
                headers.update(_POLICY)
                message["headers"] = headers.raw
            await send(message)

        # Nothing behind this gets to see the token, so that nothing can print it.
        told = {**scope, "query_string": b"", "state": {**scope.get("state", {}), WRITES: writes}}
        await self._app(told, receive, send_with_policy)

    def _refusal(self, connection: HTTPConnection, *, writes: bool) -> tuple[int, str]:
        refusal = self._access.refusal(connection)
        if refusal:
            return 403, refusal
        if connection.scope["method"] not in {"GET", "HEAD"}:
            return 405, "only GET is answered"
        if connection.headers.get("content-length", "0") != "0" or "transfer-encoding" in connection.headers:
            return 413, "a request has no body here"
        path = connection.scope["path"]
        if path not in {"/", ICON} and not path.startswith(FILES):
            return 404, "there is no such page: the dashboard is at /"
        if path == "/" and not self._access.has_room(writes=writes):
            return 503, f"{PAGES} pages are open already: close one, and wait a minute"
        return 200, ""

    async def _listen(self, scope: Scope, receive: Receive, send: Send) -> None:
        connection = HTTPConnection(scope)
        refusal = self._access.refusal(connection)
        page = self._access.page_of(connection)
        # A session is not taken over from another way of transport: there is none.
        if refusal or not scope["path"].startswith(SOCKETS) or "sid" in _query(connection):
            await send({"type": "websocket.close", "code": 1008, "reason": refusal})
            return
        if page:
            self._connections.belongs(scope["client"], page)

        async def receive_what_is_allowed() -> Message:
            while (message := await receive())["type"] == "websocket.receive":
                verdict = judge(message.get("text"), page, writes=self._access.writes(page))
                if verdict is Verdict.PASSED:
                    break
                if verdict is Verdict.CUT_OFF:
                    await send({"type": "websocket.close", "code": 1008})
                    return {"type": "websocket.disconnect", "code": 1008}
            return message

        await self._app(scope, receive_what_is_allowed, send)


def _query(connection: HTTPConnection) -> dict[str, list[str]]:
    try:
        return parse_qs(connection.scope["query_string"].decode("latin-1"))
    except ValueError:
        # More fields than Python takes.
        return {}


def _is_number(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_loopback(name: str) -> bool:
    return name == "localhost" or (_is_number(name) and ipaddress.ip_address(name).is_loopback)
