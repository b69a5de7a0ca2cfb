"""The dashboard's own graph: nodes and recordings it starts, beside what it sees of any graph."""

import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from lifecycle_msgs.msg import Transition

from ehls_ros.dashboard.graph import Answer
from ehls_ros.errors import BadInput
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import Spec, load_spec
from ehls_ros.nodes.control import REALTIME
from ehls_ros.nodes.dashboard_link import Link
from ehls_ros.nodes.graph import (
    PLANTS,
    RECORDER,
    SIMULATED,
    UP_TIME,
    Running,
    graph_environment,
    last_line,
    node_parameters,
    node_processes,
    share_processors,
)

STORAGE = "mcap"


class DashboardGraph(Link):
    """What :class:`ehls_ros.dashboard.graph.Graph` asks for, over ROS."""

    def __init__(self) -> None:
        """Join the graph of this process's domain."""
        super().__init__()
        self._changing = threading.Lock()
        self._nodes = _Started()
        self._recorder = _Started()
        self._doing = ""

    def close(self) -> None:
        """End what was started here and leave the graph."""
        self.give_up()
        with self._changing:
            self._recorder.end()
            self._nodes.end()
        super().close()

    def started_here(self) -> bool:
        """Tell whether nodes run that were started here."""
        return bool(self._nodes.running)

    def recording(self) -> bool:
        """Tell whether a recording that was begun here goes on."""
        return bool(self._recorder.running)

    def activity(self) -> str:
        """Say in a sentence what was started here: nodes, recording, files."""
        dead = [f"{node.name} ended: {last_line(node.log)}" for node in self._nodes.dead() + self._recorder.dead()]
        parts = [self._doing, *dead, self._nodes.says, self._recorder.says]
        return " ".join(part for part in parts if part)

    def start(self, spec: Spec, name: str) -> Answer:
        """Start the nodes for a spec, in real time and without an end; returns once they run."""
        with self._changing:
            if self.started_here() or self.rate():
                return Answer(done=False, message="a graph runs already: end it first")
            try:
                folder = _folder(spec, name)
                folder.logs.mkdir()
            except (BadInput, OSError) as error:
                return Answer(done=False, message=str(error))
            parameters = node_parameters(spec, SIMULATED, folder, REALTIME, STORAGE)
            del parameters[RECORDER]
            parameters[SIMULATED.node]["cycles"] = 0
            self._nodes.begin(parameters, folder)
            refusal = self._activate()
            self._doing = ""
            if refusal:
                self._nodes.end()
                return Answer(done=False, message=refusal)
            self._nodes.says = f"Spec and logs of the nodes are in {folder.path}."
            return Answer(done=True, message=f"{name} runs")

    def stop(self) -> Answer:
        """End the nodes that were started here, and a recording of them."""
        with self._changing:
            if not self.started_here():
                return Answer(done=False, message="no graph was started here: end it where it was started")
            self._end_recording()
            self._nodes.end()
            return Answer(done=True, message="the graph has ended")

    def record(self, *, on: bool) -> Answer:
        """Begin a recording of whatever graph runs, or end it."""
        with self._changing:
            if on == self.recording():
                return Answer(done=False, message="a recording goes on already" if on else "there is no recording")
            if not on:
                self._end_recording()
                return Answer(done=True, message=self._recorder.says)
            try:
                spec, name = self._spec_of_graph()
                folder = _folder(spec, f"{name}-recording")
                folder.logs.mkdir()
            except (BadInput, OSError) as error:
                return Answer(done=False, message=str(error))
            chosen = {"spec": str(folder.spec.resolve()), "timing": REALTIME}
            bag = {"bag": str(folder.bag.resolve()), "storage": STORAGE}
            self._recorder.begin({RECORDER: {**chosen, **bag}}, folder)
            self._recorder.says = f"Recording to {folder.bag}."
            return Answer(done=True, message=self._recorder.says)

    def _end_recording(self) -> None:
        if self.recording():
            bag = self._recorder.folder.bag
            self._recorder.end()
            self._recorder.says = f"Recorded: {bag}."

    def _activate(self) -> str:
        """Take the started nodes through their lifecycle, the plant last; return what went wrong."""
        running = self._nodes.running
        deadline = time.monotonic() + UP_TIME
        for transition, verb in ((Transition.TRANSITION_CONFIGURE, "compiling"), (Transition.TRANSITION_ACTIVATE, "starting")):
            for node in running:
                self._doing = f"{node.name}: {verb} …"
                answer = self.change_state(node.name, transition, deadline - time.monotonic())
                if dead := self._nodes.dead():
                    return f"{dead[0].name} ended: {last_line(dead[0].log)}"
                if not answer.done:
                    return f"{answer.message}: {last_line(node.log)}"
            if transition == Transition.TRANSITION_CONFIGURE:
                share_processors(running, REALTIME)
        return ""

    def _spec_of_graph(self) -> tuple[Spec, str]:
        """Return the spec the plant of the graph was started with, and its name.

        Raises:
            BadInput: no plant says.
        """
        for plant in PLANTS.values():
            if plant in self.tunable_nodes():
                path = Path(self.text_parameter(plant, "spec"))
                name = self._nodes.folder.path.name if self.started_here() else path.stem
                return load_spec(path), name
        raise BadInput("nothing stands for the rig", "graph", f"one of {', '.join(PLANTS.values())}")


class _Started:
    """Processes that were started here, and their end."""

    def __init__(self) -> None:
        self.running: list[Running] = []
        self.folder = RunFolder(Path())
        self.says = ""
        self._stack = ExitStack()

    def begin(self, parameters: dict[str, dict[str, Any]], folder: RunFolder) -> None:
        self.folder = folder
        self.running = self._stack.enter_context(node_processes(list(parameters), parameters, folder.logs, graph_environment()))

    def end(self) -> None:
        self._stack.close()
        self.running = []
        self.says = ""

    def dead(self) -> list[Running]:
        return [node for node in self.running if node.process.poll() is not None]


def _folder(spec: Spec, name: str) -> RunFolder:
    folder = RunFolder.create(None, name, overwrite=False)
    folder.write_spec(spec)
    return folder
