"""Bar chart of a diagnosis: the removable error closed by the causes, each one's share, and the remainder."""

from collections.abc import Mapping
from html import escape
from typing import NamedTuple

from ehls_ros.diagnosis.result import ChannelGain, Diagnosis
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.report.diagnosis_findings import CHANNEL_SHORT, words
from ehls_ros.report.diagnosis_units import percent
from ehls_ros.report.page import Panel
from ehls_ros.report.plot import BLUE, PURE_NUMBER, SKY, VERMILION, Axis, Trace, Unit, plane_layout

ROW_OF_BAR, BAR_WIDTH = 52, 0.5
"""Height of a bar of shares with its label in pixels, and the fraction of it taken by the bar."""


class _Bar(NamedTuple):
    """A bar of shares of the removable error: its label, and the length of each part, by the part's name."""

    label: str
    parts: Mapping[str, float]


CLOSED, RETURNS, REMAINS = "closed by the causes", "returns without that cause", "remains"
_PARTS = ((CLOSED, BLUE), (RETURNS, SKY), (REMAINS, VERMILION))


def share_bars(found: Diagnosis) -> Panel | None:
    """Draw each channel's removable error closed by the causes, its remainder, and the share of each cause."""
    gains = {} if found.gain is None else found.gain.channels
    bars = [bar for channel, closed in gains.items() for bar in _bars(found, channel, closed)]
    if not bars:
        return None
    rows = list(range(len(bars), 0, -1))
    traces: list[Trace] = [
        {
            "type": "bar",
            "orientation": "h",
            "x": [100.0 * bar.parts.get(part, 0.0) for bar in bars],
            "y": rows,
            "width": BAR_WIDTH,
            "name": part,
            "marker": {"color": color},
            "hovertemplate": f"{part}: %{{x:,.3~g}} %<extra></extra>",
        }
        for part, color in _PARTS
        if any(part in bar.parts for bar in bars)
    ]
    longest = max(sum(bar.parts.values()) for bar in bars)
    layout = plane_layout(
        Axis("share of the removable error", Unit("%"), (0.0, 102.0 * max(longest, 1.0))),
        Axis("", PURE_NUMBER, (0.4, len(bars) + 0.8)),
    )
    layout["yaxis"]["visible"] = False
    label = {"x": 0.0, "xanchor": "left", "yanchor": "bottom", "showarrow": False, "font": {"size": 11}}
    layout |= {
        "barmode": "stack",
        "margin": layout["margin"] | {"l": 14},
        "annotations": [
            label | {"y": row + 0.5 * BAR_WIDTH, "text": escape(bar.label)} for row, bar in zip(rows, bars, strict=True)
        ],
    }
    note = (
        "100 % is the mean square of the given model's residual beyond the noise. A cause's share is what returns without it,"
        " all others fitted again; shares need not add up, as causes may replace or need each other."
    )
    return Panel("Shares of the error", traces, layout, note, height=100 + ROW_OF_BAR * len(bars), over_time=False)


def _bars(found: Diagnosis, channel: Channel, gain: ChannelGain) -> list[_Bar]:
    closed = max(gain.closed, 0.0)
    own = [cause for cause in found.causes if cause.channel == channel]
    sizes = f"{percent(closed)} closed, {percent(1.0 - closed)} remains"
    first = _Bar(f"{CHANNEL_SHORT[channel]}: {sizes}", {CLOSED: closed, REMAINS: 1.0 - closed})
    if len(own) < 2:
        return [first]
    shares = [(words(cause.name).noun, max(cause.share or 0.0, 0.0)) for cause in own]
    return [first, *(_Bar(f"{percent(share)}: {noun}", {RETURNS: share}) for noun, share in shares)]
