"""Limits on the number and duration of the server's connections.

Any host that reaches the port can open connections and send nothing, or read nothing. A connection therefore has a few seconds
to make its request, and the oldest connection of an address with too many is cut so that others can connect. The socket of an
open page is not counted.

Time is counted in passes of the server's loop, a second or more apart, so that clients do not time out while the server stalls.
"""

import asyncio
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum, auto
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

MAX_PER_PEER = 16
"""Maximum number of connections of one address outside a page; a browser opens six."""

MAX_CONNECTIONS = 64
"""Maximum number of connections of all addresses outside a page."""

MAX_SOCKETS_PER_PAGE = 2
"""Maximum number of sockets of one page: the one in use, and one lost without notice to the server."""

PASS = 1.0
"""Time between two passes [s]."""

MAX_HEAD = 16 * 1024
"""Maximum size of the request line and headers [B]."""

_BLANK_LINE = re.compile(rb"\n\r?\n")

_TOO_LARGE = (
    b"HTTP/1.1 431 Request Header Fields Too Large\r\ncontent-type: text/plain; charset=utf-8\r\nconnection: close\r\n\r\n"
    b"request line and headers may have %d bytes\n" % MAX_HEAD
)


class ConnectionState(Enum):
    """State of a connection."""

    ASKING = auto()
    ANSWERED = auto()
    OF_PAGE = auto()
    CLOSING = auto()


PASSES = {ConnectionState.ASKING: 5, ConnectionState.ANSWERED: 60, ConnectionState.CLOSING: 5}
"""Maximum number of passes in a state: making the request, reading the answer, closing."""

Address = tuple[str, int]


class Connections:
    """The connections of one server."""

    def __init__(self) -> None:
        """Start without connections."""
        self._open: dict[Address, _Connection] = {}

    def protocol(self) -> type[asyncio.Protocol]:
        """Return a protocol class that registers its connections here and limits the size of request headers."""
        connections = self

        class Protocol(H11Protocol):
            def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
                connections.opened(transport)
                super().connection_made(transport)

            def handle_events(self) -> None:
                # h11 limits incomplete heads only: a head received complete in a single read would pass.
                if self.conn.their_state is h11.IDLE and _head_size(self.conn.trailing_data[0]) > MAX_HEAD:
                    self.transport.write(_TOO_LARGE)
                    self.transport.close()
                    return
                super().handle_events()

        return Protocol

    def opened(self, transport: asyncio.Transport) -> None:
        """Register a connection; if there are too many, cut the oldest, those still making their request first."""
        peer = transport.get_extra_info("peername")
        self._open[_address(peer)] = _Connection(transport)
        counted = [
            address for address, one in self._open.items() if one.state() in {ConnectionState.ASKING, ConnectionState.ANSWERED}
        ]
        held = Counter(host for host, _ in counted)
        host, most = peer[0], held[peer[0]]
        if len(counted) > MAX_CONNECTIONS:
            host, most = held.most_common(1)[0]
        if most > MAX_PER_PEER or len(counted) > MAX_CONNECTIONS:
            self._cut(
                min((a for a in counted if a[0] == host), key=lambda a: self._open[a].state() is ConnectionState.ANSWERED)
            )

    @contextmanager
    def answered(self, peer: Any) -> Iterator[None]:
        """Grant a connection the time of an answer.

        Args:
            peer: host and port as the transport and the ASGI scope give them.
        """
        connection = self._open.get(_address(peer))
        if connection is None:
            yield
            return
        connection.answered = True
        try:
            yield
        finally:
            connection.answered = False
            connection.passes = 0

    def belongs(self, peer: Any, page: str) -> None:
        """Keep a connection open as the socket of a page; beyond :data:`PER_PAGE`, the page's oldest is cut.

        Args:
            peer: host and port as the transport and the ASGI scope give them.
            page: the page's id.
        """
        connection = self._open.get(_address(peer))
        if connection is None:
            return
        connection.page = page
        same = [address for address, one in self._open.items() if one.page == page and one.state() is ConnectionState.OF_PAGE]
        if len(same) > MAX_SOCKETS_PER_PAGE:
            self._cut(same[0])

    async def cut_slow(self) -> None:
        """Cut connections that take too long, until cancelled."""
        while True:
            await asyncio.sleep(PASS)
            for address, connection in list(self._open.items()):
                if connection.is_overdue():
                    self._cut(address)

    def _cut(self, address: Address) -> None:
        # Abort rather than close: a peer that stopped reading would keep a closing connection open for ever.
        self._open.pop(address).transport.abort()


class _Connection:
    """One connection and its time in the present state."""

    def __init__(self, transport: asyncio.Transport) -> None:
        self.transport = transport
        self.answered = False
        self.page = ""
        self.passes = 0
        self._last_state = ConnectionState.ASKING

    def state(self) -> ConnectionState:
        # A slow reader still has data to fetch: its connection is neither idle nor, if it is to close afterwards, closing.
        unsent = self.transport.get_write_buffer_size() > 0
        if self.transport.is_closing() and (self.page or not unsent):
            return ConnectionState.CLOSING
        if self.page:
            return ConnectionState.OF_PAGE
        return ConnectionState.ANSWERED if self.answered or unsent else ConnectionState.ASKING

    def is_overdue(self) -> bool:
        """Count a pass; return whether the state has lasted too long."""
        state = self.state()
        self.passes = self.passes + 1 if state is self._last_state else 1
        self._last_state = state
        return self.passes > PASSES.get(state, self.passes)


def _head_size(received: bytes) -> int:
    """Return the size of the request line and headers at the beginning of received data, as far as received [B]."""
    end = _BLANK_LINE.search(received)
    return len(received) if end is None else end.end()


def _address(peer: Any) -> Address:
    host, port = peer[:2]
    return str(host), int(port)
