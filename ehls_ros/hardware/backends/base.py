"""What a DAQ backend's file provides: ``Parameters`` and ``open``, which gives a :class:`Device`.

A device moves raw values, those of the converters (V for converter cards; whatever a real-time target was told to send).
What they mean is the calibration's business (:mod:`ehls_ros.hardware.calibration`).
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol


class Channel(NamedTuple):
    """One converter channel.

    Attributes:
        number: the card's or target's number of the channel, from 0.
        range: smallest and largest raw value.
    """

    number: int
    range: tuple[float, float]


class Wiring(NamedTuple):
    """Which channels a rig uses.

    Attributes:
        inputs: the sensors' channels; a reading has its values in this order.
        output: the valve's channel.
        null: raw command at which the valve is closed, within the output's range.
    """

    inputs: tuple[Channel, ...]
    output: Channel
    null: float


class Reading(NamedTuple):
    """One sample of all inputs.

    Attributes:
        sequence: number of the sample. A gap: samples were lost. A number no larger than the last: the device began anew.
        time_ns: the device's own time of the sample [ns].
        values: raw values in the order of the wiring's inputs, all finite.
        at_null: the device keeps its output at null by itself, for want of valid commands.
    """

    sequence: int
    time_ns: int
    values: tuple[float, ...]
    at_null: bool = False


class Device(Protocol):
    """An open device. All methods are called from one thread."""

    def read(self, timeout: float) -> Reading | None:
        """Wait for the next sample; where several wait, the newest is taken.

        Args:
            timeout: longest time to wait [s].

        Returns:
            The sample, or None where none came in time.

        Raises:
            WorkFailed: the device is lost.
        """

    def write(self, value: float, sequence: int) -> None:
        """Set the output; a value that is no number sets it to null, one out of range to the range's end.

        Args:
            value: raw command.
            sequence: number of the sample it answers.

        Raises:
            WorkFailed: the device is lost.
        """

    def close(self) -> None:
        """Set the output to null and let go of the device; a second call does nothing."""

    def figures(self) -> Mapping[str, int]:
        """Return what was counted since the start, such as samples lost, by name."""


class Backend(Protocol):
    """The attributes of one backend's file."""

    Parameters: Any

    def open(self, parameters: Any, wiring: Wiring, period: float) -> Device:
        """Open a device, its output at null.

        Args:
            parameters: the backend's own.
            wiring: the channels to use.
            period: sampling period [s].

        Raises:
            BadInput: a parameter or channel does not fit the device, or a library is not installed.
            WorkFailed: the device cannot be opened.
        """


def permitted(value: float, wiring: Wiring) -> float:
    """Return the raw command that may go out for one asked for: within the output's range, null for what is no number."""
    if not math.isfinite(value):
        return wiring.null
    low, high = wiring.output.range
    return min(max(value, low), high)
