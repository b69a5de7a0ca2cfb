"""Parts that the results of several functions share: figures, files, fields and their view in a notebook."""

from collections.abc import Callable, Iterable
from dataclasses import fields
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ehls_ros.errors import BadInput
from ehls_ros.report.page import PLOTLY, LeftOut, Panel

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

UNUSED = ("zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "autoScale2d", "select2d", "lasso2d")
"""Buttons left out: dragging zooms, and a double click resets the view."""


def figure(panel: Panel | LeftOut) -> "Figure":
    """Return a report's figure as a plotly object, which notebooks display and users can modify.

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


def written(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Write a file, creating its folder if necessary, and return its path.

    Raises:
        BadInput: the file cannot be written.
    """
    file = Path(path)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write(file)
    except OSError as error:
        raise BadInput(f"it cannot be written ({error.strerror})", str(file), "a writable place") from None
    return file


def fields_of(kind: Any, found: object) -> dict[str, Any]:
    """Return the values of the fields that a dataclass declares, by name."""
    return {field.name: getattr(found, field.name) for field in fields(kind)}


def html(heading: str, table: str, remarks: Iterable[str], more: str = "") -> str:
    """Return the view of a result in a notebook.

    Args:
        heading: in bold; empty: none.
        table: HTML of its table.
        remarks: list below the table.
        more: text after the heading.
    """
    first = f"<p><b>{escape(heading)}</b>{escape(more)}</p>" if heading else ""
    entries = "".join(f"<li>{escape(remark)}</li>" for remark in remarks)
    return f"{first}{table}{f'<ul>{entries}</ul>' if entries else ''}"
