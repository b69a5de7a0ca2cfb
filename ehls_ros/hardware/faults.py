"""Faults injected into the emulated rig while it runs, for tests; each is one line of text."""

import math
from collections.abc import Sequence

from ehls_ros.errors import BadInput

FAULTS = {
    "stick": "stick SIGNAL: the sensor keeps its last value",
    "bias": "bias SIGNAL VALUE: VALUE is added to the reading",
    "jump": "jump SIGNAL VALUE: VALUE is added to the reading for one sample",
    "nan": "nan SIGNAL: the sensor reads NaN",
    "clock": "clock SECONDS: the target's clock steps",
    "silent": "silent: no measurements are sent",
    "deaf": "deaf: no packets are accepted",
    "delay": "delay SECONDS: packets take so much longer, in both directions; not in lockstep",
    "clear": "clear: all faults end",
}
WHERE = "fault"


class Faults:
    """The active faults.

    Attributes:
        silent: no measurements are sent.
        deaf: no packets are accepted.
        delay: additional time that packets take [s].
        clock_ns: offset added to the target's time [ns].
    """

    def __init__(self, wired: Sequence[str]) -> None:
        """Start without faults; ``wired`` names the signals in the order of the values passed to :meth:`spoil`."""
        self._wired = tuple(wired)
        self.clock_ns = 0
        self._clear()

    def apply(self, line: str) -> None:
        """Inject the fault described by a line.

        Raises:
            BadInput: the line is none of :data:`FAULTS`, or names a signal that is not wired.
        """
        match line.split():
            case ["stick", signal]:
                self._stuck[self._index(signal)] = math.nan
            case ["bias", signal, value]:
                self._bias[self._index(signal)] = _number(value)
            case ["jump", signal, value]:
                self._jump[self._index(signal)] = _number(value)
            case ["nan", signal]:
                self._bias[self._index(signal)] = math.nan
            case ["clock", value]:
                self.clock_ns += round(1e9 * _number(value))
            case ["delay", value] if _number(value) >= 0.0:
                self.delay = _number(value)
            case ["silent"]:
                self.silent = True
            case ["deaf"]:
                self.deaf = True
            case ["clear"]:
                self._clear()
            case _:
                raise BadInput(f"line is {line!r}", WHERE, "; ".join(FAULTS.values()))

    def spoil(self, signals: list[float]) -> None:
        """Apply the sensor faults in place.

        Args:
            signals: one per wired signal [SI].
        """
        for index, bias in self._bias.items():
            signals[index] += bias
        for index, jump in self._jump.items():
            signals[index] += jump
        self._jump.clear()
        for index, kept in self._stuck.items():
            if math.isnan(kept):
                self._stuck[index] = signals[index]
            signals[index] = self._stuck[index]

    def _clear(self) -> None:
        self.silent = self.deaf = False
        self.clock_ns = 0
        self.delay = 0.0
        self._stuck: dict[int, float] = {}
        self._bias: dict[int, float] = {}
        self._jump: dict[int, float] = {}

    def _index(self, signal: str) -> int:
        if signal not in self._wired:
            raise BadInput(f"signal is {signal!r}", WHERE, f"one of {', '.join(self._wired)}")
        return self._wired.index(signal)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInput(f"value is {text!r}", WHERE, "a finite number")
    return value
