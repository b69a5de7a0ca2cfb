"""The real-time target's side of the wire: who it listens to, and its watchdog. What firmware has to do, in Python."""

import secrets
from typing import Any

from ehls_ros.hardware.packet import Codec, Kind, Packet, Status

SILENCE = 0.1
"""Time without a command of the computer that greeted last, after which another one may greet the target [s]."""

LONGEST_WATCHDOG = 1.0
"""Time that the target holds a command at most, whatever the command says [s]."""

REASONS = ("busy", "stranger", "session", "order", "late", "kind")
"""Why a whole packet is refused: another computer is in command; it is of another address; of no or an earlier session; no
newer than the last; it answers a measurement older than the watchdog's time; it is no hello and no command."""


class Target:
    """Sessions, the last command and the watchdog.

    Once the watchdog has closed the valve, or another computer takes over, only a command of null opens the way for others:
    who has not seen that the valve was closed would open it again in one step.

    Attributes:
        address: where measurements go; None before the first hello.
        answered: sequence number of the measurement that the last command answers; -1 before the first command.
        commanded: number of commands taken since the hello.
        greeted: a hello came since this was last set to False.
    """

    def __init__(self, codec: Codec, period: float, null: float) -> None:
        """Start with a new session.

        Args:
            codec: with the shared key, if there is one.
            period: time between two measurements [s].
            null: output where there is no command.
        """
        self._codec = codec
        self._period = period
        self._null = null
        self._session = secrets.randbits(64) | 1
        self._peer = 0
        self._heard = 0.0
        self._command = null
        self._commanded_at = 0.0
        self._watchdog = 0.0
        self._tripped = False
        self._locked = False
        self.address: Any = None
        self.answered = -1
        self.commanded = 0
        self.greeted = False
        self._counts = dict.fromkeys(("commands", "watchdog", *REASONS), 0)

    def receive(self, data: bytes, sender: Any, now: float, cycle: int) -> None:
        """Take a packet from the net, or refuse it.

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
        """Return the raw output of now and why it is at null, if it is.

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

    def measurement(self, cycle: int, time_ns: int, status: Status, values: tuple[float, ...]) -> bytes:
        """Return the packet of a measurement.

        Args:
            cycle: its sequence number.
            time_ns: the target's time [ns].
            status: why the output is at null.
            values: raw values by channel number.
        """
        packet = Packet(Kind.MEASUREMENT, self._session, self._peer, cycle, self.commanded, time_ns, 0, status, values)
        return self._codec.pack(packet)

    def figures(self) -> dict[str, int]:
        """Return counts: commands taken, times the watchdog acted, packets refused by reason."""
        damaged = {f"refused_{reason}": count for reason, count in self._codec.refused.items()}
        return {**self._counts, **damaged}

    def _greet(self, packet: Packet, sender: Any, now: float) -> str:
        if packet.session != self._peer or sender != self.address:
            if self._peer and now - self._heard < SILENCE:
                return "busy"
            self._locked = self._peer != 0
            self._peer, self.address, self._heard = packet.session, sender, now
            self.answered, self.commanded = -1, 0
        self.greeted = True
        return ""

    def _take(self, packet: Packet, sender: Any, now: float, cycle: int) -> str:
        wrong = self._unfit(packet, sender, cycle)
        if wrong:
            return wrong
        self.commanded, self.answered = packet.sequence, packet.answered
        self._command = packet.values[0]
        self._locked &= self._command != self._null
        self._watchdog = min(1e-6 * packet.watchdog_us, LONGEST_WATCHDOG)
        self._commanded_at = self._heard = now
        self._tripped = False
        self._counts["commands"] += 1
        return ""

    def _unfit(self, packet: Packet, sender: Any, cycle: int) -> str:
        """Return the reason why a command is not taken; empty if it is."""
        if packet.kind != Kind.COMMAND:
            return "kind"
        if sender != self.address:
            return "stranger"
        if packet.session != self._peer or packet.peer != self._session or packet.answered > cycle:
            return "session"
        if packet.sequence <= self.commanded:
            return "order"
        if (cycle - packet.answered) * self._period > 1e-6 * packet.watchdog_us:
            return "late"
        return ""
