"""UDP to a real-time target with the converters; :mod:`ehls_ros.hardware.packet` defines the packets.

The target sends to the computer that greeted it with a hello. Its measurements repeat this side's random session number, and
this side's commands repeat the target's, so that replayed recordings and senders who cannot read the traffic are refused.
Exercised against ``ehls rig-emulator``, never against a target's firmware.
"""

import ipaddress
import select
import socket
import time
from collections.abc import Mapping
from typing import Annotated, NamedTuple

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.hardware.backends.base import Reading, Wiring, permitted
from ehls_ros.hardware.packet import MAX_AT_ONCE, MAX_KEY, MAX_SIZE, Codec, Kind, Packet, Status, random_session
from ehls_ros.schema import quantity, text

WHERE = "backend: udp"

WAITS = True
"""The target may be ``ehls rig-emulator --lockstep``."""

HELLO_INTERVAL = 0.02
"""Silence of the target after which it is greeted, and interval between greetings [s]."""

SENDER_REASONS = ("stranger", "session", "order", "channels")
"""Why a valid packet is refused: unknown sender address; wrong or earlier session; not newer than the last; too few values."""


class Parameters(NamedTuple):
    """Addresses of both sides, the watchdog time and the shared key."""

    host: Annotated[str, text("the target's IP address")] = "127.0.0.1"
    port: Annotated[int, quantity("1", "the target's UDP port", minimum=1, maximum=65535)] = 5810
    bind: Annotated[str, text("IP address of this computer to send from and listen on")] = "127.0.0.1"
    local_port: Annotated[int, quantity("1", "UDP port of this computer; 0: any", minimum=0, maximum=65535)] = 0
    watchdog: Annotated[
        float, quantity("s", "time without a valid command after which the target goes to null", minimum=1e-3, maximum=1.0)
    ] = 0.01
    key: Annotated[str, text("secret both sides share, up to 64 bytes; empty: packets are not authenticated")] = ""


def codec(parameters: Parameters) -> Codec:
    """Return the codec with the shared key.

    Raises:
        BadInput: the key is too long.
    """
    key = parameters.key.encode()
    if len(key) > MAX_KEY:
        raise BadInput(f"key has {len(key)} bytes", WHERE, f"at most {MAX_KEY}")
    return Codec(key)


def bound_socket(host: str, port: int) -> socket.socket:
    """Return a non-blocking UDP socket that listens on an address of this computer.

    Raises:
        BadInput: it is no address of this computer, or the port is taken.
    """
    family = socket.AF_INET if _address(host, "bind").version == 4 else socket.AF_INET6
    opened = socket.socket(family, socket.SOCK_DGRAM)
    try:
        opened.bind((host, port))
    except OSError as error:
        opened.close()
        raise BadInput(
            f"{host}, port {port} cannot be used ({error.strerror})", WHERE, "a free port of this computer"
        ) from None
    opened.setblocking(False)
    return opened


def _address(host: str, key: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        raise BadInput(f"{key} is {host!r}", WHERE, "an IP address such as 127.0.0.1") from None


def _check_way(parameters: Parameters) -> None:
    """Check that the two addresses can reach each other."""
    target, here = _address(parameters.host, "host"), _address(parameters.bind, "bind")
    if target.version != here.version or target.is_loopback != here.is_loopback:
        raise BadInput(f"bind is {here}", WHERE, f"this computer's address on the network of the target, {target}")


class UdpDevice:
    """The target as a device."""

    def __init__(self, parameters: Parameters, wiring: Wiring) -> None:
        """Open the socket; the first read greets the target."""
        _check_way(parameters)
        self._codec = codec(parameters)
        self._socket = bound_socket(parameters.bind, parameters.local_port)
        self._target = (parameters.host, parameters.port)
        self._watchdog_us = round(parameters.watchdog * 1e6)
        self._wiring = wiring
        self._channels = tuple(channel.number for channel in wiring.inputs)
        self._values = max(self._channels) + 1
        self._session = random_session()
        self._peer = 0
        self._past: set[int] = set()
        self._last = -1
        self._answered = 0
        self._sent = 0
        self._greet_at = 0.0
        self._figures = dict.fromkeys(("received", "lost", "skipped", "hellos", "targets", "unsent", *SENDER_REASONS), 0)

    def read(self, timeout: float) -> Reading | None:
        """Wait for the next measurement; see :class:`~ehls_ros.hardware.backends.base.Device`."""
        now = time.monotonic()
        deadline = now + timeout
        while (reading := self._newest()) is None:
            now = time.monotonic()
            if now >= self._greet_at:
                self._greet(now)
            if now >= deadline:
                return None
            select.select((self._socket,), (), (), min(deadline, self._greet_at) - now)
        return reading

    def write(self, value: float, sequence: int) -> None:
        """Send a command; see :class:`~ehls_ros.hardware.backends.base.Device`."""
        if self._peer == 0:
            return  # no target has answered yet
        self._sent += 1
        command = Packet(
            kind=Kind.COMMAND,
            session=self._session,
            peer=self._peer,
            sequence=self._sent,
            answered=max(sequence, 0),
            time_ns=time.monotonic_ns(),
            watchdog_us=self._watchdog_us,
            values=(permitted(value, self._wiring),),
        )
        self._send(command)

    def close(self) -> None:
        """Command null and close the socket."""
        if self._socket.fileno() >= 0:
            self.write(self._wiring.null, self._last)
            self._socket.close()

    def figures(self) -> Mapping[str, int]:
        """Return counts: packets received, lost, superseded, refused by reason; hellos; commands not yet acknowledged."""
        return {**self._figures, **self._codec.figures(), "sent": self._sent, "not_taken": self._sent - self._answered}

    def _newest(self) -> Reading | None:
        newest = None
        for _ in range(MAX_AT_ONCE):
            try:
                data, sender = self._socket.recvfrom(MAX_SIZE + 1)
            except BlockingIOError:
                break
            except OSError as error:
                raise WorkFailed(f"the socket to the target failed ({error.strerror})") from error
            reading = self._reading(data, sender)
            if reading is not None:
                self._figures["skipped"] += newest is not None
                newest = reading
        return newest

    def _reading(self, data: bytes, sender: tuple[str, int]) -> Reading | None:
        if sender[:2] != self._target:
            self._figures["stranger"] += 1
            return None
        packet = self._codec.parse(data)
        if packet is None:
            return None
        wrong = self._unfit(packet)
        if wrong:
            self._figures[wrong] += 1
            return None
        if packet.session != self._peer:
            self._past.add(self._peer)
            self._peer, self._last, self._sent = packet.session, -1, 0
            self._figures["targets"] += 1
        elif packet.sequence > self._last + 1:
            self._figures["lost"] += packet.sequence - self._last - 1
        self._figures["received"] += 1
        self._last, self._answered = packet.sequence, packet.answered
        self._greet_at = time.monotonic() + HELLO_INTERVAL
        values = tuple(packet.values[channel] for channel in self._channels)
        return Reading(packet.sequence, packet.time_ns, values, packet.status != Status.COMMANDED, packet.session)

    def _unfit(self, packet: Packet) -> str:
        """Return why a valid packet is refused; empty if it is accepted."""
        if packet.kind != Kind.MEASUREMENT or packet.peer != self._session or packet.session in self._past:
            return "session"
        if packet.session == self._peer and packet.sequence <= self._last:
            return "order"
        if len(packet.values) < self._values:
            return "channels"
        return ""

    def _greet(self, now: float) -> None:
        self._figures["hellos"] += 1
        self._greet_at = now + HELLO_INTERVAL
        hello = Packet(Kind.HELLO, self._session, self._peer, self._figures["hellos"], time_ns=time.monotonic_ns())
        self._send(hello)

    def _send(self, packet: Packet) -> None:
        try:
            self._socket.sendto(self._codec.pack(packet), self._target)
        except OSError:
            # The network may recover; until then the target's watchdog keeps the valve closed.
            self._figures["unsent"] += 1


def open(parameters: Parameters, wiring: Wiring, period: float) -> UdpDevice:  # noqa: A001
    """Open the socket; the target's clock paces the samples.

    Raises:
        BadInput: an address, the port or the key cannot be used.
    """
    return UdpDevice(parameters, wiring)
