"""The emulated rig's end of the network: a UDP socket, and one with network impairments."""

import contextlib
import heapq
import random
import select
import socket
import time
from typing import Annotated, Any, NamedTuple

from ehls_ros.hardware.packet import MAX_AT_ONCE, MAX_SIZE
from ehls_ros.hardware.realtime import sleep_until
from ehls_ros.schema import quantity

Datagram = tuple[bytes, Any]
"""Bytes and the address they came from."""


class Impairments(NamedTuple):
    """Impairments of the network, applied in both directions."""

    latency: Annotated[float, quantity("s", "delay of every packet", minimum=0.0, maximum=1.0)] = 0.0
    jitter: Annotated[float, quantity("s", "largest additional delay, uniformly distributed", minimum=0.0, maximum=1.0)] = 0.0
    loss: Annotated[float, quantity("1", "fraction of packets lost", minimum=0.0, maximum=1.0)] = 0.0
    duplicate: Annotated[float, quantity("1", "fraction of packets duplicated", minimum=0.0, maximum=1.0)] = 0.0
    reorder: Annotated[float, quantity("1", "fraction of packets overtaken by the next one", minimum=0.0, maximum=1.0)] = 0.0
    corrupt: Annotated[float, quantity("1", "fraction of packets with one bit flipped", minimum=0.0, maximum=1.0)] = 0.0


class Wire:
    """A socket that is polled once a cycle.

    Attributes:
        delay: additional time that packets take [s]; only of a :class:`BadWire`.
    """

    delay = 0.0

    def __init__(self, opened: socket.socket) -> None:
        """Take a bound, non-blocking socket."""
        self._socket = opened
        self.unsent = 0

    def wait(self, deadline: float) -> float:
        """Wait until a time of ``time.monotonic`` [s] and return the time."""
        return sleep_until(deadline)

    def await_packet(self, timeout: float) -> None:
        """Wait for a packet, at most ``timeout`` [s]."""
        select.select((self._socket,), (), (), timeout)

    def received(self) -> list[Datagram]:
        """Return the packets that have arrived."""
        packets: list[Datagram] = []
        with contextlib.suppress(BlockingIOError):
            while len(packets) < MAX_AT_ONCE:
                packets.append(self._socket.recvfrom(MAX_SIZE + 1))
        return packets

    def send(self, data: bytes, address: Any) -> None:
        """Send a packet; refusals by the system are counted."""
        try:
            self._socket.sendto(data, address)
        except OSError:
            self.unsent += 1


class BadWire(Wire):
    """A socket whose packets are delayed, lost, duplicated, reordered and damaged."""

    def __init__(self, opened: socket.socket, impairments: Impairments, period: float, seed: int) -> None:
        """Take a bound, non-blocking socket.

        Args:
            opened: the socket.
            impairments: of the network.
            period: time between packets; an overtaken one is delayed by one and a half periods [s].
            seed: of the random draws.
        """
        super().__init__(opened)
        self._impairments = impairments
        self._overtaken = 1.5 * period
        self._random = random.Random(seed)  # noqa: S311
        self._count = 0
        self._inward: list[tuple[float, int, bytes, Any]] = []
        self._outward: list[tuple[float, int, bytes, Any]] = []

    def wait(self, deadline: float) -> float:
        """Wait, moving packets that arrive or fall due meanwhile."""
        while (now := time.monotonic()) < deadline:
            self._move(now)
            due = min(deadline, self._outward[0][0]) if self._outward else deadline
            select.select((self._socket,), (), (), max(due - now, 0.0))
        self._move(now)
        return now

    def received(self) -> list[Datagram]:
        """Return the packets that have passed the impairments and are due."""
        now = time.monotonic()
        self._move(now)
        packets: list[Datagram] = []
        while self._inward and self._inward[0][0] <= now:
            packets.append(heapq.heappop(self._inward)[2:])
        return packets

    def send(self, data: bytes, address: Any) -> None:
        """Queue a packet."""
        now = time.monotonic()
        self._impair(self._outward, now, data, address)
        self._move(now)

    def _move(self, now: float) -> None:
        for data, sender in super().received():
            self._impair(self._inward, now, data, sender)
        while self._outward and self._outward[0][0] <= now:
            super().send(*heapq.heappop(self._outward)[2:])

    def _impair(self, queue: list[tuple[float, int, bytes, Any]], now: float, data: bytes, address: Any) -> None:
        p, chance = self._impairments, self._random.random
        if chance() < p.loss:
            return
        for _ in range(1 + (chance() < p.duplicate)):
            delay = self.delay + p.latency + p.jitter * chance() + self._overtaken * (chance() < p.reorder)
            self._count += 1
            heapq.heappush(queue, (now + delay, self._count, self._damaged(data), address))

    def _damaged(self, data: bytes) -> bytes:
        if self._random.random() >= self._impairments.corrupt:
            return data
        bit = self._random.randrange(8 * len(data))
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        return bytes(damaged)
