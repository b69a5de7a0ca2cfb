"""Calibration of the converters: gain, offset and range of each sensor channel and of the valve channel."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.hardware.backends.base import Channel, Wiring, permitted
from ehls_ros.physics.rig import EVERY_SENSED, SENSED
from ehls_ros.schema import quantity, text


class Input(NamedTuple):
    """A sensor's channel: signal = scale (raw - offset)."""

    channel: Annotated[int, quantity("1", "number of the channel, from 0", minimum=0, maximum=31)]
    scale: Annotated[float, quantity("signal/raw", "SI units per raw unit")]
    offset: Annotated[float, quantity("raw", "raw value at which the signal is 0")] = 0.0
    range: Annotated[tuple[float, float], text("smallest and largest raw value of the converter")] = (-10.0, 10.0)
    bits: Annotated[int, quantity("1", "resolution of the converter", minimum=8, maximum=32)] = 16


class Output(NamedTuple):
    """The valve channel: spool command = scale (raw - offset)."""

    channel: Annotated[int, quantity("1", "number of the channel, from 0", minimum=0, maximum=31)]
    scale: Annotated[float, quantity("m/raw", "spool command per raw unit")]
    offset: Annotated[float, quantity("raw", "raw value at which the valve is closed")] = 0.0
    range: Annotated[tuple[float, float], text("smallest and largest raw value sent to the valve")] = (-5.0, 5.0)
    bits: Annotated[int, quantity("1", "resolution of the converter", minimum=8, maximum=32)] = 16


def step(channel: Input | Output) -> float:
    """Return the step of a channel's converter, in raw units."""
    low, high = channel.range
    return math.ldexp(high - low, -channel.bits)


def check_channel(channel: Input | Output, where: str) -> None:
    """Check that the fields of a channel agree.

    Raises:
        BadInput: the range is empty, the scale is 0, or the output's offset is out of range.
    """
    low, high = channel.range
    if not -math.inf < low < high < math.inf:
        raise BadInput(f"range is {list(channel.range)}", where, "two finite numbers [min, max] with min < max")
    if channel.scale == 0.0:
        raise BadInput("scale is 0", where, "a factor other than 0")
    if isinstance(channel, Output) and not low < channel.offset < high:
        raise BadInput(
            f"offset is {channel.offset:g}", where, f"the value of the closed valve, in the range [{low:g}, {high:g}]"
        )


class Calibration:
    """Converts raw values to signals and the spool command to a raw value.

    Attributes:
        sensed: signals of a sample; those of both chambers are among them if one of them has a channel.
        wiring: the channels, for a backend; inputs in the order of ``sensed``.
        wired: the signals that have a channel, in the same order.
        inputs: their channels.
        output: the valve channel.
    """

    def __init__(self, inputs: Mapping[str, Input], output: Output) -> None:
        """Take checked channels.

        Args:
            inputs: channels by signal of ``EVERY_SENSED``; a signal left out is not wired and reads NaN.
            output: the valve channel.
        """
        self.sensed = SENSED if set(inputs) <= set(SENSED) else EVERY_SENSED
        self.wired = tuple(signal for signal in self.sensed if signal in inputs)
        self.inputs = tuple(inputs[signal] for signal in self.wired)
        self.output = output
        channels = tuple(Channel(used.channel, used.range) for used in self.inputs)
        self.wiring = Wiring(channels, Channel(output.channel, output.range), output.offset)
        self._rows = tuple(self.sensed.index(signal) for signal in self.wired)
        self._lines = tuple((used.scale, used.offset) for used in self.inputs)
        # The largest code is one step below the upper end of the range.
        self._rails = tuple((used.range[0] + 0.5 * step(used), used.range[1] - 1.5 * step(used)) for used in self.inputs)

    def signals(self, values: Sequence[float]) -> tuple[float, ...]:
        """Convert the raw values of one sample to signals.

        Args:
            values: raw values in the order of the wiring's inputs.

        Returns:
            The signals in the order of ``sensed`` [SI]; NaN where a signal is not wired.
        """
        signals = [math.nan] * len(self.sensed)
        for row, value, (scale, offset) in zip(self._rows, values, self._lines, strict=True):
            signals[row] = scale * (value - offset)
        return tuple(signals)

    def saturated(self, values: Sequence[float]) -> tuple[str, ...]:
        """Return the signals whose converter is at or beyond an end of its range, so that their values are invalid.

        Args:
            values: raw values in the order of the wiring's inputs.
        """
        ends = zip(self.wired, values, self._rails, strict=True)
        return tuple(signal for signal, value, (low, high) in ends if not low < value < high)

    def command(self, spool: float) -> float:
        """Return the raw command for a spool command [m], clipped to the range; null for NaN and infinity."""
        return permitted(spool / self.output.scale + self.output.offset, self.wiring)
