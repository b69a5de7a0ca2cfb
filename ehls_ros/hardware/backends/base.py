"""Interface of a DAQ backend: its file provides ``Parameters`` and ``open``, which returns a :class:`Device`.

A device reads and writes raw values: V for converter cards, the target's own unit for a real-time target. The calibration
(:mod:`ehls_ros.hardware.calibration`) converts them.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol


class Channel(NamedTuple):
    """One converter channel.

    Attributes:
        number: of the channel on the card or target, from 0.
        range: smallest and largest raw value.
    """

    number: int
    range: tuple[float, float]


class Wiring(NamedTuple):
    """Which channels a rig uses.

    Attributes:
        inputs: the sensor channels; a reading has its values in this order.
        output: the valve channel.
        null: raw command at which the valve is closed, within the output's range.
    """

    inputs: tuple[Channel, ...]
    output: Channel
    null: float


class Reading(NamedTuple):
    """One sample of all inputs.

    Attributes:
        sequence: number of the sample. A gap means lost samples, a number not above the last one a restarted device.
        time_ns: time of the sample by the device's clock, which runs freely: no time server adjusts it [ns].
        values: raw values in the order of the wiring's inputs, all finite.
        at_null: the device keeps its output at null, because it has no valid command.
        session: changes when the device restarts; 0 where only the sequence number shows that.
    """

    sequence: int
    time_ns: int
    values: tuple[float, ...]
    at_null: bool = False
    session: int = 0


class Device(Protocol):
    """An open device. All methods are called from one thread."""

    def read(self, timeout: float) -> Reading | None:
        """Wait for the next sample; if several are queued, return the newest.

        Args:
            timeout: longest time to wait [s].

        Returns:
            The sample; None on timeout.

        Raises:
            WorkFailed: the device is lost.
        """

    def write(self, value: float, sequence: int) -> None:
        """Set the output; NaN and infinity set it to null, a value out of range to the end of the range.

        Args:
            value: raw command.
            sequence: number of the sample it answers.

        Raises:
            WorkFailed: the device is lost.
        """

    def close(self) -> None:
        """Set the output to null and release the device; a second call does nothing."""

    def figures(self) -> Mapping[str, int]:
        """Return counts since the start, such as samples lost, by name."""


class Backend(Protocol):
    """The attributes of a backend's file.

    A device that waits for the answer to each sample, as lockstep requires, has ``WAITS = True``.
    """

    Parameters: Any

    def open(self, parameters: Any, wiring: Wiring, period: float) -> Device:
        """Open a device, its output at null.

        Args:
            parameters: an instance of the backend's ``Parameters``.
            wiring: the channels to use.
            period: sampling period [s].

        Raises:
            BadInput: a parameter or channel does not fit the device, or a library is not installed.
            WorkFailed: the device cannot be opened.
        """


def permitted(value: float, wiring: Wiring) -> float:
    """Clip a raw command to the output's range; return null for NaN and infinity."""
    if not math.isfinite(value):
        return wiring.null
    low, high = wiring.output.range
    return min(max(value, low), high)
