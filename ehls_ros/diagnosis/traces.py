"""Traces for the plots of a diagnosis: each channel's residuals over its windows."""

from collections.abc import Mapping

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.result import ChannelTrace
from ehls_ros.diagnosis.stages import UNITS, Channel


def trace(evidence: Evidence, channel: Channel, after: Array, signals: Mapping[str, Array]) -> ChannelTrace:
    """Return a channel's residual for plots.

    Args:
        evidence: the recording compared with the given model.
        channel: the channel.
        after: residual with the causes, of the usable windows, in the channel's unit, shape (n,).
        signals: signals it may depend on, by name, one value per sample.
    """
    floor = evidence.floor[channel]
    return ChannelTrace(
        channel=channel,
        unit=UNITS[channel],
        size=evidence.sizes[channel],
        time=evidence.times[channel],
        measured=evidence.comparison().measured(evidence.rig, channel)[evidence.masks[channel]],
        before=evidence.base.values[channel] * floor,
        after=after,
        floor=floor,
        noise=evidence.noise[channel] * floor,
        against={name: evidence.means(channel, values) for name, values in signals.items() if name != "time_s"},
    )
