"""The figures of the reports as plotly's own objects, which notebooks show and users can change."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ehls_ros.errors import BadInput
from ehls_ros.report.page import LeftOut, Panel

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

TITLE_HEIGHT = 26
"""Room for the title above the legend, in pixels."""


def figure(panel: Panel | LeftOut) -> "Figure":
    """Return a report's figure as plotly's object.

    Raises:
        BadInput: what it would show was not recorded, or plotly is not installed.
    """
    if isinstance(panel, LeftOut):
        raise BadInput(f"there is nothing to draw ({panel.reason})", panel.title, "a recording with these signals")
    try:
        plotly: Any = import_module("plotly.graph_objects")
    except ImportError:
        raise BadInput("plotly is not installed", panel.title, "pip install plotly") from None
    margin = panel.layout["margin"]
    title = {"text": panel.title, "x": 0, "xanchor": "left", "y": 1, "yanchor": "top", "pad": {"t": 8, "l": 8}}
    layout = panel.layout | {
        "title": title | {"font": {"size": 14}},
        "margin": margin | {"t": margin["t"] + TITLE_HEIGHT},
        "height": panel.height + TITLE_HEIGHT,
    }
    drawn: Figure = plotly.Figure({"data": list(panel.traces), "layout": layout}, skip_invalid=True)
    return drawn
