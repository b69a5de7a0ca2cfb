"""The card over the empty plots: progress of the nodes being started, or how to start a graph."""

from html import escape

from nicegui import ui

from ehls_ros.dashboard.graph import Beginning, Graph

PATIENCE = (
    "The control law and the simulated rig are being compiled for this machine: about half a minute the first time, a few "
    "seconds later on. The plots then start automatically."
)

NONE_HERE = "The plots start automatically when a graph runs."

NONE_WITH_CONTROLS = "Start one under Experiment or from another terminal. The plots then start automatically."


class BeginningCard:
    """Card shown until a graph has been seen, and again while another one is being started."""

    def __init__(self, graph: Graph, *, writes: bool) -> None:
        """Build the card in the current slot.

        Args:
            graph: the graph to be started.
            writes: whether the page has a Start button.
        """
        self._none = f"Looking in {graph.where}. {NONE_WITH_CONTROLS if writes else NONE_HERE}"
        with ui.element("section").classes("beginning").props('data-name="beginning"') as self._card:
            self._title = ui.label("").classes("title")
            self._nodes = ui.html("", sanitize=False, tag="dl")
            self._words = ui.label("").classes("said")

    def show(self, beginning: Beginning | None, *, was_there: bool) -> None:
        """Update the card.

        Args:
            beginning: progress of the nodes, if any are being started.
            was_there: whether the plots have anything to show.
        """
        self._card.set_visibility(beginning is not None or not was_there)
        self._title.set_text(f"Starting the graph: {beginning.seconds:.0f} s" if beginning else "No graph is running")
        self._nodes.set_visibility(beginning is not None)
        rows = beginning.nodes.items() if beginning else ()
        self._nodes.set_content("".join(f"<dt>{escape(node)}</dt><dd>{escape(doing)}</dd>" for node, doing in rows))
        self._words.set_text(PATIENCE if beginning else self._none)
