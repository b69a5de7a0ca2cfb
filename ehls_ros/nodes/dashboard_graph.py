"""The dashboard's access to a graph: starts nodes and recordings, besides observing any graph."""

import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from lifecycle_msgs.msg import Transition

from ehls_ros.dashboard.graph import Answer, GraphSnapshot, NodeHealth, StartProgress, Timing, shortened
from ehls_ros.dashboard.tuning_job import Applicable, TuningJob
from ehls_ros.errors import BadInput
from ehls_ros.experiments.graph_check import Graph as Checked
from ehls_ros.experiments.graph_check import bridge_at, check_fit
from ehls_ros.experiments.real_rig import for_real_rig
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import Spec, chosen_spec, for_simulated_rig, with_programme
from ehls_ros.nodes import SUFFIX
from ehls_ros.nodes.control import NAMESPACE
from ehls_ros.nodes.dashboard_link import READ_INTERVAL, Link
from ehls_ros.nodes.graph import (
    REALTIME_PRIORITY,
    SIMULATED,
    UP_TIME,
    Plant,
    Running,
    graph_environment,
    last_line,
    node_parameters,
    node_processes,
    share_processors,
)
from ehls_ros.nodes.graph_nodes import LOCKSTEP, PLANTS, PROGRAMME, REALTIME, RECORDER, reference_node

STORAGE = "mcap"

START_TIME = 1.0
"""Time over which the reference of a graph started here is led in from the rig's present position [s]."""

STARTING, COMPILING, READY, RUNNING, ENDED = "starting", "compiling", "ready", "running", "ended"
"""Stages of a node: process starting, configuring, waiting for the others, running, dead."""


class DashboardGraph(Link):
    """:class:`ehls_ros.dashboard.graph.Graph` over ROS."""

    def __init__(self, namespace: str = NAMESPACE, plant: Plant = SIMULATED) -> None:
        """Join the graph of this process's domain.

        Args:
            namespace: see :class:`Link`.
            plant: plant of the graphs started here.
        """
        super().__init__(namespace)
        self._plant = plant
        self.simulated = plant.bridge is None and plant.kind == SIMULATED.kind
        self._recorded: RunFolder | None = None
        self._results: dict[str, _Result] = {}
        self._tuning = TuningJob()
        self._changing = threading.Lock()
        self._nodes = _StartedProcesses()
        self._recorder = _StartedProcesses()
        self._cancelled = threading.Event()
        self._start_time: float | None = None
        self._timing = LOCKSTEP
        self._stages: dict[str, str] = {}
        self._failure = ""

    def close(self) -> None:
        """Stop everything started here and leave the graph."""
        self.abort()
        self._tuning.close()
        with self._changing:
            self._recorder.end()
            self._nodes.end()
        super().close()

    def started_here(self) -> bool:
        """Return whether nodes started here are running."""
        return bool(self._nodes.running)

    def snapshot(self) -> GraphSnapshot:
        """Return the present state of everything the page shows besides the signals."""
        return GraphSnapshot(
            rate=self.rate(),
            period=self.period,
            health=self.health(),
            starting=self.starting(),
            complaint=self.complaint(),
            activity=self.activity(),
            started_here=self.started_here(),
            recording=self.recording(),
            recorded=self._recorded is not None,
            results={verb: result.sentence for verb, result in self._results.items()},
            rig=self.rig_health(),
            laws=self.laws(),
            on_rig=self.on_rig(),
            tuning=self._tuning.state(),
        )

    def recording(self) -> bool:
        """Return whether a recording started here is running."""
        return bool(self._recorder.running)

    def starting(self) -> StartProgress | None:
        """Return the progress of the nodes being started here; None if none are."""
        began = self._start_time
        if began is None:
            return None
        return StartProgress(time.monotonic() - began, {node.name: self._stage(node) for node in self._nodes.running})

    def complaint(self) -> str:
        """Return which node started here died, and the last line of its log; empty if none did."""
        return " ".join([self._failure, *map(_death_notice, self._nodes.dead() + self._recorder.dead())]).strip()

    def activity(self) -> str:
        """Return one sentence on the recording and the files started here."""
        return " ".join(part for part in (self._nodes.status, self._recorder.status) if part)

    def health(self) -> tuple[NodeHealth, ...]:
        """Return the nodes' diagnostics; a node that is compiling cannot publish any and is shown as OK."""
        starting = self.starting()
        busy = {node for node, stage in starting.nodes.items() if stage == COMPILING} if starting else set()
        return tuple(
            health._replace(level=0, message=COMPILING) if health.node in busy else health for health in super().health()
        )

    def start(self, spec: Spec, name: str, timing: Timing) -> Answer:
        """Start the nodes of a spec, with no last cycle; return once they run."""
        with self._changing:
            if self.started_here() or self.rate():
                return Answer(done=False, message="a graph is already running: stop it first")
            spec, assumed = (for_simulated_rig(spec), ()) if self.simulated else for_real_rig(spec)
            try:
                bridge = None if self.simulated else bridge_at(self._plant.bridge)
                remarks = assumed + check_fit(spec, Checked(bridge=bridge, lockstep=timing is not Timing.REALTIME), name)
                folder = _folder(spec, name)
                folder.logs.mkdir()
            except (BadInput, OSError) as error:
                return Answer(done=False, message=str(error))
            self._timing = REALTIME if timing is Timing.REALTIME else LOCKSTEP
            parameters = node_parameters(spec, self._plant, folder, self._timing, STORAGE)
            del parameters[RECORDER]
            parameters[self._plant.node]["cycles"] = 0
            if self.simulated:
                parameters[self._plant.node]["speed"] = 1.0 if timing is Timing.LOCKSTEP else 0.0
            parameters[reference_node(spec)]["start_time"] = START_TIME
            self._cancelled.clear()
            self._stages, self._failure = {}, ""
            self._start_time = time.monotonic()
            self._nodes.begin(parameters, folder, self.namespace)
            refusal = self._activate()
            if refusal:
                self._end_nodes()
                self._failure = "" if self._cancelled.is_set() else refusal
            self._start_time = None
            if refusal:
                return Answer(done=False, message=refusal)
            self._nodes.status = " ".join([*(f"{remark}." for remark in remarks), f"Spec and logs are in {folder.path}."])
            return Answer(done=True, message=f"{name} is running")

    def stop(self) -> Answer:
        """Stop the nodes started here, and their recording."""
        self._cancelled.set()
        starting = self.starting() is not None
        with self._changing:
            if starting and not self.started_here():
                return Answer(done=True, message="the start was cancelled")
            if not self.started_here():
                return Answer(done=False, message="no graph was started here: stop it where it was started")
            self._end_recording()
            self._end_nodes()
            return Answer(done=True, message="the graph has stopped")

    def record(self, *, on: bool) -> Answer:
        """Start recording the running graph, or end the recording."""
        with self._changing:
            if on == self.recording():
                return Answer(done=False, message="already recording" if on else "not recording")
            if not on:
                self._end_recording()
                return Answer(done=True, message=self._recorder.status)
            try:
                spec, name, timing = self._spec_of_graph()
                folder = _folder(spec, f"{name}-recording")
                folder.logs.mkdir()
            except (BadInput, OSError) as error:
                return Answer(done=False, message=str(error))
            chosen: dict[str, Any] = {"spec": str(folder.spec.resolve()), "timing": timing}
            chosen |= {"priority": REALTIME_PRIORITY} if timing == REALTIME else {}
            bag = {"bag": str(folder.bag.resolve()), "storage": STORAGE}
            self._recorder.begin({RECORDER: {**chosen, **bag}}, folder, self.namespace)
            self._recorder.status = f"Recording to {folder.bag}."
            return Answer(done=True, message=self._recorder.status)

    def evaluate(self, verb: str) -> Answer:
        """Evaluate the last recording that ended here with a verb of ``ehls``, in a process of its own."""
        folder = self._recorded
        if folder is None:
            return Answer(done=False, message="no recording has ended here")
        results = folder.path / verb
        words = {"verify": ["--out", str(results)], "report": ["--out", str(folder.report)]}[verb]
        command = ["nice", sys.executable, "-m", "ehls_ros.cli.main", verb, str(folder.path), *words]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        while True:
            try:
                output, errors = process.communicate(timeout=READ_INTERVAL)
                break
            except subprocess.TimeoutExpired:
                if self._closing.is_set():
                    process.terminate()
        if process.returncode:
            return Answer(done=False, message=shortened((errors.splitlines() or [f"{verb} was ended"])[-1]))
        document = folder.report if verb == "report" else results / folder.report.name
        sentence = shortened(output.partition("\n")[0])
        self._results[verb] = _Result(document, sentence)
        return Answer(done=True, message=sentence)

    def tune(self, spec: Spec | None, name: str) -> Answer:
        """Begin to tune a law for an experiment; without one, the driving law for that of the running graph."""
        try:
            if spec is None:
                spec, name, law = self._experiment_of_graph()
            else:
                # As it would be started here.
                spec = for_simulated_rig(spec) if self.simulated else for_real_rig(spec).spec
                law = spec.controller.name
        except BadInput as error:
            return Answer(done=False, message=shortened(str(error)))
        return self._tuning.begin(spec, name, law)

    def cancel_tuning(self) -> Answer:
        """End the running tuning without a result."""
        return self._tuning.cancel()

    def apply_tuning(self, folder: str, *, confirmed: bool) -> Answer:
        """Set the numbers found in the running node of their law, if the graph is what they were found for."""
        try:
            found = self._applicable(folder, confirmed=confirmed)
        except BadInput as error:
            return Answer(done=False, message=shortened(str(error)))
        node = f"{found.law}{SUFFIX}"
        answer = self.set_parameters(node, {number.name: number.found for number in found.result.numbers})
        if not answer.done:
            return answer
        answer = answer._replace(message=f"{node}: {answer.message}.{self._not_as_simulated(node, found)}")
        self._tuning.note_application(found, f"Applied at {time.strftime('%H:%M:%S')} to {answer.message}")
        return answer

    def _applicable(self, folder: str, *, confirmed: bool) -> Applicable:
        """Return the numbers of a tuning.

        Raises:
            BadInput: they are not for this graph, or may not be applied to it.
        """
        found = self._tuning.applicable(folder)
        if found.law not in self.laws():
            raise BadInput(f"no {found.law}{SUFFIX} is running", "Apply", "a graph with that controller")
        spec, name, _ = self._experiment_of_graph()
        if not found.is_for(spec, name):
            raise BadInput("the numbers were found for another rig or experiment", "Apply", "to tune for this one")
        if self.on_rig() and not confirmed:
            raise BadInput("this graph may drive a real rig", "Apply", "the operator's confirmation")
        return found

    def _not_as_simulated(self, node: str, found: Applicable) -> str:
        """Return a sentence on the numbers of a node that were neither tuned nor simulated with; empty if there are none."""
        simulated = found.task.controller.parameters._asdict()
        tuned = {number.name for number in found.result.numbers}
        differing = [
            f"{each.name} is {each.value}, was {simulated[each.name]}"
            for each in self.parameters(node)
            if each.name in simulated and each.name not in tuned and each.value != simulated[each.name]
        ]
        return f" Not as in the simulation: {'; '.join(differing)}." if differing else ""

    def document(self, name: str) -> Path | None:
        """Return a document of an evaluation or of a tuning; None if there is none of that name."""
        return self._results[name].document if name in self._results else self._tuning.document(name)

    def _end_nodes(self) -> None:
        """Stop the nodes without reporting their silence."""
        names = {node.name for node in self._nodes.running}
        self._nodes.end()
        self.forget(names)

    def _end_recording(self) -> None:
        if self.recording():
            folder = self._recorder.folder
            self._recorder.end()
            self._recorder.status = f"Recorded: {folder.bag}."
            self._recorded, self._results = folder, {}

    def _activate(self) -> str:
        """Configure and activate the started nodes; return the reason of a failure, or an empty string."""
        running = self._nodes.running
        deadline = time.monotonic() + UP_TIME
        # Configured in parallel, as compiling dominates; activated in order, the plant last.
        with ThreadPoolExecutor(len(running)) as pool:
            configured = pool.map(
                lambda node: self._transition(node, Transition.TRANSITION_CONFIGURE, READY, deadline), running
            )
            refusals = [refusal for refusal in configured if refusal]
        if refusals:
            return self._failure_reason(refusals[0])
        share_processors(running, self._timing)
        for node in running:
            if refusal := self._transition(node, Transition.TRANSITION_ACTIVATE, RUNNING, deadline):
                return self._failure_reason(refusal)
        return ""

    def _transition(self, node: Running, transition: int, reached: str, deadline: float) -> str:
        """Request a transition of a node; return the reason of a failure, or an empty string."""
        answer = self.change_state(node.name, transition, deadline - time.monotonic(), self._is_hopeless)
        if not answer.done:
            return f"{answer.message}: {last_line(node.log)}"
        self._stages[node.name] = reached
        return ""

    def _is_hopeless(self) -> bool:
        return self._cancelled.is_set() or bool(self._nodes.dead())

    def _failure_reason(self, refusal: str) -> str:
        """Return the reason for a failed start: a node that died takes precedence over nodes that waited for it."""
        if self._cancelled.is_set():
            return "stopped before it was running"
        if duplicates := self.duplicates(node.name for node in self._nodes.running):
            elsewhere = "stop that first, or set another ROS_DOMAIN_ID or --namespace"
            return f"{self.where} already has a running {', '.join(duplicates)}: {elsewhere}"
        return next(map(_death_notice, self._nodes.dead()), refusal)

    def _stage(self, node: Running) -> str:
        if node.process.poll() is not None:
            return ENDED
        return self._stages.get(node.name) or (COMPILING if self.is_up(node.name) else STARTING)

    def _spec_of_graph(self) -> tuple[Spec, str, str]:
        """Return the spec the graph's plant was started with, its name, and the timing.

        Raises:
            BadInput: there is no plant node.
        """
        for plant in PLANTS.values():
            if plant in self.tunable_nodes():
                file, rig, timing = self.text_parameters(plant, ("spec", "rig", "timing"))
                name = self._nodes.folder.path.name if self.started_here() else Path(file).stem
                return chosen_spec(file, rig), name or "experiment", timing
        raise BadInput("there is no plant node", "graph", f"one of {', '.join(PLANTS.values())}")

    def _experiment_of_graph(self) -> tuple[Spec, str, str]:
        """Return the experiment that runs, its name, and the driving law.

        Raises:
            BadInput: plant or controller is missing or does not answer, or a file cannot be read.
        """
        laws = self.laws()
        if not laws:
            raise BadInput("there is no controller's node", "graph", "a running controller")
        spec, name, _ = self._spec_of_graph()
        if any(health.node == PROGRAMME for health in self.health()):
            spec = with_programme(spec, *self.text_parameters(PROGRAMME, ("programme",)))
        return spec, name, laws[0]


class _Result(NamedTuple):
    """Document and first sentence of an evaluation."""

    document: Path
    sentence: str


class _StartedProcesses:
    """Processes started here."""

    def __init__(self) -> None:
        self.running: list[Running] = []
        self.folder = RunFolder(Path())
        self.status = ""
        self._stack = ExitStack()

    def begin(self, parameters: Mapping[str, Mapping[str, Any]], folder: RunFolder, namespace: str) -> None:
        self.folder = folder
        processes = node_processes(list(parameters), parameters, folder.logs, graph_environment(), namespace)
        self.running = self._stack.enter_context(processes)

    def end(self) -> None:
        # Nodes end one after the other: those being stopped have not died.
        self.running = []
        self._stack.close()
        self.status = ""

    def dead(self) -> list[Running]:
        return [node for node in self.running if node.process.poll() is not None]


def _death_notice(node: Running) -> str:
    return f"{node.name} died: {last_line(node.log)}"


def _folder(spec: Spec, name: str) -> RunFolder:
    folder = RunFolder.create(None, name, overwrite=False)
    folder.write_spec(spec)
    return folder
