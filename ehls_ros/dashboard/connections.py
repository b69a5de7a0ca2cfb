"""How many connections the server holds, and for how long.

Whoever reaches the port may open connections and send nothing, or read nothing. So a connection has only seconds to say
what it wants, and the more of them one address holds, the sooner they are cut: others then still get in. What has shown that
it belongs to a page is not counted with them, so that an open page stays.

Time is counted in passes of the server's loop, a second or more apart: a server that was kept from working has not waited.
"""

import asyncio
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum, auto
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

PER_PEER = 16
"""Connections of one address that belong to no page; a browser opens six."""

IN_ALL = 64
"""Connections of all addresses that belong to no page."""

PER_PAGE = 2
"""Sockets of one page: the one in use, and one that was lost without the server being told."""

PASS = 1.0
"""Time between two passes [s]."""


class State(Enum):
    """What a connection is doing."""

    ASKING = auto()
    ANSWERED = auto()
    OF_PAGE = auto()
    CLOSING = auto()


PASSES = {State.ASKING: 5, State.ANSWERED: 60, State.CLOSING: 5}
"""Passes a connection may stay in a state: to say what it wants, to take the answer, to take the last of it."""

Address = tuple[str, int]


class Connections:
    """The connections of one server."""

    def __init__(self) -> None:
        """Start without any."""
        self._open: dict[Address, _Connection] = {}

    def protocol(self) -> type[asyncio.Protocol]:
        """Return the protocol of a connection, which makes it known here; its requests' heads are bounded by h11."""
        connections = self

        class Protocol(H11Protocol):
            def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
                connections.opened(transport)
                super().connection_made(transport)

        return Protocol

    def opened(self, transport: asyncio.Transport) -> None:
        """Take note of a connection, and cut another one where there are too many: one that asks, and the oldest of those."""
        peer = transport.get_extra_info("peername")
        self._open[_address(peer)] = _Connection(transport)
        counted = [address for address, one in self._open.items() if one.state() in {State.ASKING, State.ANSWERED}]
        held = Counter(host for host, _ in counted)
        host, most = peer[0], held[peer[0]]
        if len(counted) > IN_ALL:
            host, most = held.most_common(1)[0]
        if most > PER_PEER or len(counted) > IN_ALL:
            self._cut(min((a for a in counted if a[0] == host), key=lambda a: self._open[a].state() is State.ANSWERED))

    @contextmanager
    def answered(self, peer: Any) -> Iterator[None]:
        """Give a connection the time of an answer.

        Args:
            peer: as the transport and ASGI's scope name it.
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
        """Let a connection stay for as long as it likes, as the socket of a page; the page's oldest beyond two is cut.

        Args:
            peer: as the transport and ASGI's scope name it.
            page: the page's number.
        """
        connection = self._open.get(_address(peer))
        if connection is None:
            return
        connection.page = page
        same = [address for address, one in self._open.items() if one.page == page and one.state() is State.OF_PAGE]
        if len(same) > PER_PAGE:
            self._cut(same[0])

    async def watch(self) -> None:
        """Cut what takes too long, until cancelled."""
        while True:
            await asyncio.sleep(PASS)
            for address, connection in list(self._open.items()):
                if connection.takes_too_long():
                    self._cut(address)

    def _cut(self, address: Address) -> None:
        # What is closing may never end by itself: its peer may take nothing any more.
        self._open.pop(address).transport.abort()


class _Connection:
    """One of them."""

    def __init__(self, transport: asyncio.Transport) -> None:
        self.transport = transport
        self.answered = False
        self.page = ""
        self.passes = 0
        self._before = State.ASKING

    def state(self) -> State:
        # What was written is not yet taken: a slow reader's connection is neither idle nor, if it is to close then, closed.
        unsent = self.transport.get_write_buffer_size() > 0
        if self.transport.is_closing() and (self.page or not unsent):
            return State.CLOSING
        if self.page:
            return State.OF_PAGE
        return State.ANSWERED if self.answered or unsent else State.ASKING

    def takes_too_long(self) -> bool:
        """Count a pass; tell whether the state has lasted for too many."""
        state = self.state()
        self.passes = self.passes + 1 if state is self._before else 1
        self._before = state
        return self.passes > PASSES.get(state, self.passes)


def _address(peer: Any) -> Address:
    host, port = peer[:2]
    return str(host), int(port)
