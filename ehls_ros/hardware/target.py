"""The real-time target's side of the protocol, with its watchdog: a Python model of the firmware."""

import math
from collections import deque
from typing import Any

from ehls_ros.hardware.packet import MAX_WATCHDOG_US, Codec, Kind, Packet, Status, random_session

SILENCE = 0.1
"""Silence of the computer in command after which another may take over [s]."""

LONGEST_WATCHDOG = 1e-6 * MAX_WATCHDOG_US
"""Longest time for which the target holds a command, and in which a measurement can be answered [s]."""

REASONS = ("busy", "stranger", "session", "order", "late", "kind")
"""Reasons for refusing a valid packet: another computer is in command; unknown sender address; wrong or earlier session; not
newer than the last; the measurement it answers is older than the watchdog time; neither hello nor command."""


class Target:
    """Sessions, the last command and the watchdog.

    After the watchdog has closed the valve, or another computer has taken over, a null command must come first: a controller
    that did not notice would otherwise reopen the valve in one step.

    Attributes:
        address: destination of the measurements; None before the first hello.
        answered: sequence number of the measurement answered by the last command; -1 before the first command.
        commanded: sequence number of the last command accepted since the hello.
        greeted: a hello has arrived since this was last set to False.
    """

    def __init__(self, codec: Codec, period: float, null: float) -> None:
        """Start with a new session.

        Args:
            codec: with the shared key, if any.
            period: time between two measurements [s].
            null: raw output that closes the valve.
        """
        self._codec = codec
        self._period = period
        self._null = null
        self._session = random_session()
        self._peer = 0
        self._last_packet = 0.0
        self._command = null
        self._commanded_at = 0.0
        self._watchdog = 0.0
        self._tripped = False
        self._locked = False
        self.address: Any = None
        self.answered = -1
        self.commanded = 0
        self.greeted = False
        self._sent: deque[tuple[int, float]] = deque(maxlen=math.ceil(LONGEST_WATCHDOG / period) + 1)
        self._counts = dict.fromkeys(("commands", "watchdog", *REASONS), 0)

    def receive(self, data: bytes, sender: Any, now: float, cycle: int) -> None:
        """Accept or refuse a datagram.

        Args:
            data: its bytes.
            sender: its address.
            now: time on the target's clock [s].
            cycle: sequence number of the last measurement sent.
        """
        packet = self._codec.parse(data)
        if packet is None:
            return
        wrong = self._greet(packet, sender, now) if packet.kind == Kind.HELLO else self._take(packet, sender, now, cycle)
        if wrong:
            self._counts[wrong] += 1

    def output(self, now: float) -> tuple[float, Status]:
        """Return the current raw output and, if it is at null, the reason.

        Args:
            now: time on the target's clock [s].
        """
        if self.answered < 0:
            return self._null, Status.WAITING
        if now - self._commanded_at > self._watchdog:
            self._counts["watchdog"] += not self._tripped
            self._tripped = self._locked = True
        if self._locked:
            return self._null, Status.WATCHDOG
        return self._command, Status.COMMANDED

    def measurement(
        self, cycle: int, time_ns: int, status: Status, values: tuple[float, ...], now: float | None = None
    ) -> bytes:
        """Pack a measurement that is sent now.

        Args:
            cycle: its sequence number.
            time_ns: the target's time [ns].
            status: reason why the output is at null.
            values: raw values by channel number.
            now: time on the target's clock, from which the age of its answer counts [s]; None: time advances with the cycles
                alone, as in lockstep.
        """
        if now is not None:
            self._sent.append((cycle, now))
        packet = Packet(Kind.MEASUREMENT, self._session, self._peer, cycle, self.commanded, time_ns, 0, status, values)
        return self._codec.pack(packet)

    def figures(self) -> dict[str, int]:
        """Return counts: commands accepted, watchdog trips, packets refused by reason."""
        return {**self._counts, **self._codec.figures()}

    def _greet(self, packet: Packet, sender: Any, now: float) -> str:
        if packet.session != self._peer or sender != self.address:
            if self._peer and now - self._last_packet < SILENCE:
                return "busy"
            self._locked = self._peer != 0
            self._peer, self.address, self._last_packet = packet.session, sender, now
            self.answered, self.commanded = -1, 0
        self.greeted = True
        return ""

    def _take(self, packet: Packet, sender: Any, now: float, cycle: int) -> str:
        wrong = self._unfit(packet, sender, now, cycle)
        if wrong:
            return wrong
        self.commanded, self.answered = packet.sequence, packet.answered
        self._command = packet.values[0]
        self._locked &= self._command != self._null
        self._watchdog = 1e-6 * packet.watchdog_us
        self._commanded_at = self._last_packet = now
        self._tripped = False
        self._counts["commands"] += 1
        return ""

    def _unfit(self, packet: Packet, sender: Any, now: float, cycle: int) -> str:
        """Return why a command is refused; empty if it is accepted."""
        if packet.kind != Kind.COMMAND:
            return "kind"
        if sender != self.address:
            return "stranger"
        if packet.session != self._peer or packet.peer != self._session or packet.answered > cycle:
            return "session"
        if packet.sequence <= self.commanded:
            return "order"
        if self._age(packet.answered, now, cycle) > 1e-6 * packet.watchdog_us:
            return "late"
        return ""

    def _age(self, answered: int, now: float, cycle: int) -> float:
        """Return the age of a measurement [s].

        The target's clock counts in addition to its cycles: a delayed target has sent fewer measurements than periods have
        passed.
        """
        by_cycles = (cycle - answered) * self._period
        if not self._sent:
            return by_cycles
        sent = (at for number, at in reversed(self._sent) if number <= answered)
        return max(by_cycles, now - next(sent, -math.inf))
