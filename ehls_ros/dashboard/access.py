"""Who may see the page and who may change things.

The page can stop a rig, so that other web pages in the same browser and other people on the same net must not reach
it: the Host header has to be one of this machine's own addresses (a name of someone else's that was made to point here
is not), an Origin header has to be the page's own, and whoever wants to change something needs the token that was
printed at the start. Over the loopback interface reading needs no token.
"""

import ipaddress
import secrets
import socket
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TOKEN = "token"  # noqa: S105 - its name, not the token
"""Name of the token in the page's address."""

_POLICY = {
    # Vue compiles templates in the browser, for which it needs eval; nothing may come from elsewhere.
    "content-security-policy": "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; form-action 'none'; base-uri 'none'",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}


class Access:
    """The rules of one server."""

    def __init__(self, host: str) -> None:
        """Make a token.

        Args:
            host: name or address the server is bound to.
        """
        self.token = secrets.token_urlsafe(16)
        self._host = host
        self._loopback = _is_loopback(host)

    def refusal(self, connection: HTTPConnection) -> str:
        """Return why a request is not answered, or nothing."""
        host = connection.headers.get("host", "")
        if not self._is_ours(host):
            return f"the Host header is {host!r}, which is none of this server's addresses"
        origin = connection.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return f"the Origin header is {origin!r}, which is not this server's"
        if TOKEN in parse_qs(connection.url.query):
            return "" if self.may_write(connection) else "the token is not the one printed when the dashboard was started"
        # The library's own files hold no secrets, and its socket serves only who knows the number of a page.
        local = connection.client is not None and _is_loopback(connection.client.host)
        if local or connection.url.path.startswith("/_nicegui"):
            return ""
        return "a token is needed: use the address printed when the dashboard was started"

    def may_write(self, connection: HTTPConnection) -> bool:
        """Tell whether a page that is asked for may change things."""
        given = parse_qs(connection.url.query).get(TOKEN, [""])[0]
        return secrets.compare_digest(given.encode(), self.token.encode())

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
    """Asks :class:`Access` before every request and every websocket."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        """Wrap an application."""
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse with code 403."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        refusal = self._access.refusal(HTTPConnection(scope))
        if refusal and scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": refusal})
            return
        if refusal:
            await PlainTextResponse(f"{refusal}\n", 403)(scope, receive, send)
            return

        async def send_with_policy(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = Headers(raw=message["headers"]).mutablecopy()
                headers.update(_POLICY)
                message["headers"] = headers.raw
            await send(message)

        await self._app(scope, receive, send_with_policy)


def _is_number(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_loopback(name: str) -> bool:
    return name == "localhost" or (_is_number(name) and ipaddress.ip_address(name).is_loopback)
