"""Figures of the reports as plotly objects, which notebooks display and users can modify."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ehls_ros.errors import BadInput
from ehls_ros.report.page import PLOTLY, LeftOut, Panel

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

UNUSED = ("zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "autoScale2d", "select2d", "lasso2d")
"""Buttons left out: dragging zooms, and a double click resets the view."""


def figure(panel: Panel | LeftOut) -> "Figure":
    """Return a report's figure as a plotly object.

    Raises:
        BadInput: the signals of the figure were not recorded, or plotly is not installed.
    """
    if isinstance(panel, LeftOut):
        raise BadInput(f"there is nothing to draw ({panel.reason})", panel.title, "a recording with these signals")
    try:
        plotly: Any = import_module("plotly.graph_objects")
    except ImportError:
        raise BadInput("plotly is not installed", panel.title, PLOTLY) from None
    layout = panel.layout | {"height": panel.height, "modebar": {"remove": list(UNUSED)}}
    drawn: Figure = plotly.Figure({"data": list(panel.traces), "layout": layout}, skip_invalid=True)
    return drawn
