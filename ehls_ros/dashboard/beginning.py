"""What lies over the pictures while they are empty: how far the nodes are that are being started, or how to get a graph."""

from html import escape

from nicegui import ui

from ehls_ros.dashboard.graph import Beginning, Graph

PATIENCE = (
    "The control law and the simulated rig are compiled for this machine. The first time that takes about half a minute, "
    "later some seconds. The pictures then begin to move by themselves."
)

NONE_HERE = "The pictures begin to move by themselves when one runs."

NONE_WITH_CONTROLS = "Start one under Experiment, or from another terminal: the pictures then begin to move by themselves."


class BeginningCard:
    """There until a graph has been looked at, and again while another one is started."""

    def __init__(self, graph: Graph, *, writes: bool) -> None:
        """Build it in the current slot.

        Args:
            graph: what is started.
            writes: whether the page has a button to start a graph.
        """
        self._none = f"Looked for in {graph.where}. {NONE_WITH_CONTROLS if writes else NONE_HERE}"
        with ui.element("section").classes("beginning").props('data-name="beginning"') as self._card:
            self._title = ui.label("").classes("title")
            self._nodes = ui.html("", sanitize=False, tag="dl")
            self._words = ui.label("").classes("said")

    def show(self, beginning: Beginning | None, *, was_there: bool) -> None:
        """Bring it up to date.

        Args:
            beginning: how far the nodes are, if any are being started.
            was_there: whether the pictures have something to show.
        """
        self._card.set_visibility(beginning is not None or not was_there)
        self._title.set_text(f"Starting the graph: {beginning.seconds:.0f} s" if beginning else "No graph runs here")
        self._nodes.set_visibility(beginning is not None)
        rows = beginning.nodes.items() if beginning else ()
        self._nodes.set_content("".join(f"<dt>{escape(node)}</dt><dd>{escape(doing)}</dd>" for node, doing in rows))
        self._words.set_text(PATIENCE if beginning else self._none)
