"""Attacks on whole graphs in lockstep: sources, controllers, programme, lifecycle, apart and in one process.

Time is that of the cycles, so a busy computer changes nothing. A sequence begins with the graph as started, and takes some
actions: second sources of every input, hand-overs between sources and between controllers, transitions, deaths, accepted
rigs, and requests to the gate. A programme is stopped, resumed, skipped and killed.
"""

import json
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import yaml
from emulated_rig import acknowledged, columns_of, own_port, trace_of
from guided import Attack, Kind
from heard import CYCLE_TOPICS, Ear
from node_server import COMMAND
from patience import PATIENCE
from policies.trace import Setup, Trace
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.srv import SwitchController
from ehls_ros.experiments.programme_records import LOG
from ehls_ros.experiments.spec import load_spec
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.hardware.gate_bounds import bounds_of, within
from ehls_ros.hardware.gate_parameters import SIMULATED
from ehls_ros.hardware.gate_parameters import Parameters as Gate
from ehls_ros.nodes.transport import control_qos
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.recording.topics import ACCEPTED_RIG

CONFIG = Path(__file__).resolve().parents[2] / "config"

COMPOSED = "composed"
"""Name of the process that several nodes share."""

SECOND_LAW = "second_law_node"
"""Name of the controller that is on standby first."""

TWICE = {
    "reference": "reference_node",
    "disturbance": "disturbance_node",
    "estimator": "friction_estimator_node",
    "plant": "plant_sim_node",
}
"""Nodes with a possible second source, by kind."""

PROGRAMME_NODE = "programme_node"

PROGRAMME = """
title: attacked
stop_time: 0.05
hold_time: 0.05
blocks:
  - repeat: 1000
    blocks:
      - {block: cycles, name: large, amplitude: 800.0, mean: 500.0, frequency: 10.0, count: 12}
      - {block: ramp, name: up, to: 900.0, time: 0.1}
      - {block: cycles, name: small, amplitude: 300.0, mean: 600.0, frequency: 20.0, count: 10}
"""

SPEED = 1.5
"""Largest speed of a simulated plant: the test must keep up with the messages."""

SETTLES = 60
"""Control cycles after which a restored graph certainly continues."""

COMES_BACK = 120.0
"""Longest time until a graph continues whose nodes all run and are active [s]."""

STALLED = 0.7
"""Longest wait for cycles of a graph that may rightly stand still, for example without a source [s]."""


class Configuration(NamedTuple):
    """A graph to attack.

    Attributes:
        plant: node of the plant.
        law: controller that drives first.
        second: controller that stands by.
        partners: other nodes.
        composed: whether plant, law and partners share a process.
        learns: whether the controllers learn from load cycle to load cycle.
    """

    plant: str
    law: str
    second: str
    partners: tuple[str, ...]
    composed: bool
    learns: bool


def configuration(number: int) -> Configuration:
    """Return the graph of a batch by its number."""
    composed = number // 2 % 2 == 1
    if number % 2 == 0:
        partners = "reference_node", "disturbance_node", "friction_estimator_node"
        return Configuration("plant_sim_node", "fasmc", "sic", partners, composed, learns=number % 3 != 0)
    law = "fasmc_output_feedback"
    return Configuration("hardware_bridge_node", law, law, ("reference_node",), composed, learns=False)


NODES = ("plant", "law", "second", "reference_node", "disturbance_node", "friction_estimator_node", PROGRAMME_NODE)


def _node(random: Random) -> tuple[str]:
    return (random.choice(NODES),)


def _death(random: Random) -> tuple[str, signal.Signals]:
    return random.choice(NODES), random.choice([signal.SIGKILL, signal.SIGINT, signal.SIGTERM])


KINDS = {
    "advance": Kind(4, lambda random: (random.choice([10, 50, 200, 500]),)),
    "second_source": Kind(5, lambda random: (random.choice(list(TWICE)),)),
    "end_second": Kind(2, lambda random: (random.choice(list(TWICE)), random.choice([signal.SIGKILL, signal.SIGINT]))),
    "hand_over_reference": Kind(3),
    "programme_begins": Kind(5),
    "programme_request": Kind(6, lambda random: (random.choice(["stop", "resume", "skip"]),)),
    "programme_dies": Kind(3, lambda random: (random.choice([signal.SIGKILL, signal.SIGINT]),)),
    "switch": Kind(6, lambda random: (random.choice(["law", "second"]),)),
    "transition": Kind(5, lambda random: (*_node(random), random.randrange(3))),
    "shut_down": Kind(0.7, _node),
    "die": Kind(2, _death),
    "freeze": Kind(1, lambda random: (*_node(random), random.uniform(0.01, 0.5))),
    "accept_rig": Kind(
        1, lambda random: (random.choice(["piston_area", "valve_gain", "moving_mass"]), random.uniform(0.8, 1.2))
    ),
    "disable": Kind(1),
    "reopen": Kind(4),
    "emergency_stop": Kind(0.7),
    "look_at_states": Kind(2),
}
"""All actions; each is a method of :class:`GraphAttacks`."""


class GraphAttacks:
    """Attacks on a graph.

    Attributes:
        done: number of times each action was taken.
        spans: beginning and end of each sequence [s].
    """

    def __init__(self, graph: Any, participant: Any, folder: Path, chosen: Configuration) -> None:
        """Start the graph and wait until its cycles advance."""
        self.graph, self.participant, self.folder, self.chosen = graph, participant, folder, chosen
        self.done: Counter[str] = Counter()
        self.spans: list[tuple[float, float]] = []
        self.stop = ""
        self.emulator: Any = None
        self.nodes = {"plant": chosen.plant, "law": f"{chosen.law}_node", "second": SECOND_LAW}
        self.nodes |= {name: name for name in (*chosen.partners, PROGRAMME_NODE)}
        self._write_files()
        spec = load_spec(self.spec)
        bounds = bounds_of(spec.rig, spec.settings.control_period)
        is_bridge = chosen.plant == "hardware_bridge_node"
        gate = within(Gate(), bounds)._replace(enable_time=0.1) if is_bridge else Gate()._replace(**SIMULATED)
        hosts = frozenset({COMPOSED if chosen.composed else chosen.plant})
        self.setup = Setup(spec.settings.control_period, spec.rig, gate, 0.01, chosen.plant, hosts, lockstep=True)
        self.ear = Ear(participant.node, (*CYCLE_TOPICS, "disturbance", "friction_estimate"))
        self.accepted = participant.node.create_publisher(String, ACCEPTED_RIG.name, control_qos(ACCEPTED_RIG.depth))
        for name in self._base():
            self._start(name)
        if is_bridge:
            self._start_emulator()
        self.come_back()

    def _write_files(self) -> None:
        measured = self.chosen.plant == "hardware_bridge_node"
        companions = [{"name": "learning", "period": 0.4}] if self.chosen.learns else []
        content = {
            "title": "attacked",
            "rig": str(CONFIG / ("rig_paper_measured.yaml" if measured else "rig_paper.yaml")),
            "duration": 1e5,
            "reference": {"name": "sine", "amplitude": 1.2e3, "frequency": 2.5},
            "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 500.0, "frequency": 2.5}},
            "controller": {"name": self.chosen.law},
            "companions": companions,
        }
        self.spec = self._file("spec.yaml", content)
        self.second_spec = self._file(
            "second.yaml",
            {**content, "reference": {"name": "constant", "value": -900.0}, "controller": {"name": self.chosen.second}},
        )
        (self.folder / "programme.yaml").write_text(PROGRAMME, encoding="utf-8")
        bridge = yaml.safe_load((CONFIG / "bridge_udp.yaml").read_text(encoding="utf-8"))
        bridge["backend"]["port"] = own_port()
        self.bridge = self._file("bridge.yaml", bridge)

    def _file(self, name: str, content: Any) -> Path:
        path = self.folder / name
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return path

    # Processes

    def _base(self) -> list[str]:
        """Return the processes of the graph, the plant last."""
        if self.chosen.composed:
            return [SECOND_LAW, COMPOSED]
        return [*self.chosen.partners, f"{self.chosen.law}_node", SECOND_LAW, self.chosen.plant]

    def _start(self, name: str) -> None:
        parameters: dict[str, Any] = {"spec": self.spec, "timing": "lockstep"}
        if name == COMPOSED:
            nodes = [self.chosen.plant, *self.chosen.partners, f"{self.chosen.law}_node"]
            words = self._words({**parameters, **self._of_plant([SECOND_LAW])})
            self.graph.run(name, ["-m", COMMAND, "run", "+".join(nodes), "--ros-args", *words])
        elif name == SECOND_LAW:
            words = self._words({**parameters, "spec": self.second_spec, "accept_rig": True})
            module = f"ehls_ros.nodes.{self.chosen.second}_node"
            self.graph.run(name, ["-m", module, "--ros-args", *words, "-r", f"__node:={name}"])
        elif name == self.chosen.plant:
            partners = [*self.chosen.partners, f"{self.chosen.law}_node", SECOND_LAW]
            self.graph.start(name, **parameters, **self._of_plant(partners))
        elif name == PROGRAMME_NODE:
            own = {"programme": self.folder / "programme.yaml", "folder": self.folder / "programme"}
            self.graph.start(name, **parameters, **own)
        else:
            own = {"accept_rig": True} if name == f"{self.chosen.law}_node" else {}
            self.graph.start(name, **parameters, **own)

    def _of_plant(self, partners: list[str]) -> dict[str, Any]:
        own = {"speed": SPEED} if self.chosen.plant == "plant_sim_node" else {"bridge": self.bridge, "enable_time": 0.1}
        return {**own, "partners": ",".join(partners)}

    @staticmethod
    def _words(parameters: dict[str, Any]) -> list[str]:
        return [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]

    def _start_emulator(self) -> None:
        self.log = self.folder / "truth.csv"
        words = [
            "--spec",
            self.spec,
            "--bridge",
            self.bridge,
            "--log",
            self.log,
            "--json",
            "--lockstep",
            "--patience",
            PATIENCE,
        ]
        command = [sys.executable, "-m", COMMAND, "rig-emulator", *map(str, words)]
        with (self.folder / "emulator.err").open("ab") as errors:
            self.emulator = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors)
        assert b"listening" in self.emulator.stdout.readline(), (self.folder / "emulator.err").read_text()

    def _process_of(self, node: str) -> str:
        """Return the name of the process that runs a node."""
        apart = {SECOND_LAW, PROGRAMME_NODE, *(f"{name} again" for name in TWICE)}
        return COMPOSED if self.chosen.composed and node not in apart else node

    def _runs(self, node: str) -> bool:
        process = self.graph.processes.get(self._process_of(node))
        return process is not None and process.poll() is None

    def _end(self, name: str, number: int = signal.SIGINT) -> None:
        """End a process, if it runs."""
        if name in self.graph.processes:
            if number == signal.SIGKILL:
                self.graph.kill(name)
            else:
                self.graph.stop(name, number)

    # Sequences

    def run(self, attack: Attack) -> None:
        """Restore the graph, then take the actions."""
        begin = time.monotonic()
        self.come_back()
        for action in attack:
            self.done[action.name] += 1
            getattr(self, action.name)(*action.arguments)
            self.advance(int(action.pause))
        self.look_at_states()
        self.spans.append((begin, time.monotonic()))

    def come_back(self) -> None:
        """Start missing processes, activate them, end superfluous ones, and wait until the cycles advance."""
        for name in (PROGRAMME_NODE, *(f"{what} again" for what in TWICE)):
            self._end(name)
        self.graph.note_ended()
        for name in self._base():
            if name not in self.graph.processes or self.graph.processes[name].poll() is not None:
                self._start(name)
        deadline = time.monotonic() + COMES_BACK
        while True:
            for node in self._nodes():
                self._activate(node)
            self.reopen()
            if self.advance(SETTLES):
                return
            assert time.monotonic() < deadline, f"the graph does not go on: {self._said()}"

    def _said(self) -> dict[str, str]:
        """Return the state of each node and the message of its last diagnostics."""
        last = {report.node: report.message for report in self.ear.reports}
        return {name: f"{self.participant.state_of(name)}, {last.get(name)}" for name in self._nodes()}

    def _nodes(self) -> list[str]:
        """Return the nodes of the base that run."""
        names = [*self.chosen.partners, f"{self.chosen.law}_node", SECOND_LAW, self.chosen.plant]
        return [name for name in names if self._runs(name)]

    def _activate(self, node: str) -> None:
        state = self.participant.state_of(node)
        if state == "finalized":
            process = self._process_of(node)
            self._end(process)
            self._start(process)
            return
        for label in {"unconfigured": ("configure", "activate"), "inactive": ("activate",)}.get(state, ()):
            # A plant that waits for its partners activates itself.
            self.participant.change(node, label)

    def trace(self) -> Trace:
        """End the run, and return its trace."""
        for name in (PROGRAMME_NODE, *(f"{what} again" for what in TWICE)):
            self._end(name)
        columns: dict[str, Any] = {}
        if self.emulator is not None:
            self.emulator.send_signal(signal.SIGINT)
            output, _ = self.emulator.communicate(timeout=PATIENCE)
            json.loads(output.splitlines()[-1])
            columns = columns_of(self.log)
        self.ear.listen()
        found = trace_of(self.setup, columns, self.ear, self.graph, self.participant)
        log = self.folder / "programme" / LOG
        lines = log.read_text(encoding="utf-8").splitlines()[1:] if log.exists() else []
        names = log.read_text(encoding="utf-8").splitlines()[0].split(",") if log.exists() else []
        rows = [dict(zip(names, line.split(","), strict=True)) for line in lines]
        return found.with_load_cycles([(int(row["load_cycle"]), int(row["first"]), int(row["last"])) for row in rows])

    def close(self) -> None:
        """End the remaining processes."""
        self.ear.close()
        if self.emulator is not None and self.emulator.poll() is None:
            self.emulator.kill()
            self.emulator.communicate()

    # Actions

    def advance(self, cycles: int) -> bool:
        """Let the graph run for some cycles; return whether it did: it may rightly stand still."""
        states = self.ear.messages.setdefault("loader_state", [])
        self.ear.listen()
        known, deadline = len(states), time.monotonic() + STALLED
        while len(states) < known + cycles and time.monotonic() < deadline:
            self.participant.rest(0.02)
            self.ear.listen()
        return len(states) >= known + cycles

    def second_source(self, what: str) -> None:
        """Start a second source of an input, unless it runs already."""
        name, node = f"{what} again", TWICE[what]
        if name in self.graph.processes or node not in (*self.chosen.partners, self.chosen.plant):
            return
        words = self._words({"spec": self.second_spec, "timing": "lockstep"})
        arguments = ["-m", f"ehls_ros.nodes.{node}", "--ros-args", *words, "-r", f"__node:={node}_2"]
        log = self.graph.folder / f"{name}.log"
        ups = log.read_text().count(": up") if log.exists() else 0
        self.graph.run(name, arguments)
        self.participant.until(lambda: log.read_text().count(": up") > ups or self.graph.processes[name].poll() is not None)

    def end_second(self, what: str, number: signal.Signals) -> None:
        self._end(f"{what} again", number)

    def hand_over_reference(self) -> None:
        """Let a second reference take over from the first, or give it back."""
        name, other = "reference again", "reference_node_2"
        if not self._runs("reference_node"):
            return
        self.second_source("reference")
        if self.participant.state_of("reference_node") == "active":
            self.participant.change("reference_node", "deactivate")
            if self._runs(name) and self.participant.state_of(other) == "inactive":
                self.participant.change(other, "activate")
        else:
            self._end(name)
            self._activate("reference_node")

    def programme_begins(self) -> None:
        """Start the programme, which begins once the reference node is deactivated."""
        if not self._runs("reference_node"):
            return
        if PROGRAMME_NODE not in self.graph.processes:
            self._start(PROGRAMME_NODE)
            log = self.graph.folder / f"{PROGRAMME_NODE}.log"
            ups = log.read_text().count(": up")
            self.participant.until(lambda: log.read_text().count(": up") > ups or not self._runs(PROGRAMME_NODE))
        self._end("reference again")
        if self.participant.state_of("reference_node") == "active":
            self.participant.change("reference_node", "deactivate")

    def programme_request(self, request: str) -> None:
        if self._runs(PROGRAMME_NODE):
            self.participant.call(Trigger, f"programme_{request}", Trigger.Request())

    def programme_dies(self, number: signal.Signals) -> None:
        """End the programme's node and restart it."""
        if self._runs(PROGRAMME_NODE):
            self._end(PROGRAMME_NODE, number)
            self._start(PROGRAMME_NODE)

    def switch(self, controller: str) -> None:
        if self._runs(self.chosen.plant):
            request = SwitchController.Request(controller=self.nodes[controller])
            self.participant.call(SwitchController, "switch_controller", request)

    def transition(self, node: str, choice: int) -> None:
        """Take a node through one of the transitions that its state allows."""
        name = self.nodes.get(node)
        if name is None or not self._runs(name):
            return
        state = self.participant.state_of(name)
        options = {"active": ["deactivate"], "inactive": ["activate", "cleanup"], "unconfigured": ["configure"]}.get(state, [])
        if options:
            self.participant.change(name, options[choice % len(options)])

    def shut_down(self, node: str) -> None:
        name = self.nodes.get(node)
        if name is not None and self._runs(name) and self.participant.state_of(name) != "finalized":
            self.participant.change(name, "shutdown")

    def die(self, node: str, number: signal.Signals) -> None:
        name = self.nodes.get(node)
        if name is not None and self._runs(name):
            self._end(self._process_of(name), number)

    def freeze(self, node: str, seconds: float) -> None:
        name = self.nodes.get(node)
        if name is not None and self._runs(name):
            process = self.graph.processes[self._process_of(name)]
            self.graph.freeze(process)
            time.sleep(seconds)
            self.graph.wake(process)

    def accept_rig(self, key: str, factor: float) -> None:
        """Publish an accepted rig with a changed coefficient to the controllers."""
        rig = rig_to_mapping(self.setup.rig)
        rig["plant"][key] *= factor
        self.accepted.publish(String(data=rig_text(rig)))

    def disable(self) -> None:
        if self._runs(self.chosen.plant):
            self.participant.call(SetBool, "enable", SetBool.Request(data=False))

    def reopen(self) -> None:
        """Acknowledge, reset and enable, once."""
        if not self._runs(self.chosen.plant):
            self.stop = ""
            return
        if self.stop:
            self.stop = acknowledged(self.participant, self.stop)
        self.participant.call(Trigger, "reset_trips", Trigger.Request())
        self.participant.call(SetBool, "enable", SetBool.Request(data=True))

    def emergency_stop(self) -> None:
        if self._runs(self.chosen.plant):
            self.stop = self.participant.call(Trigger, "emergency_stop", Trigger.Request()).message.partition(";")[0]

    def look_at_states(self) -> None:
        """Record the lifecycle state of all running nodes."""
        for name in self._nodes():
            process = self._process_of(name)
            self.participant.journal.note("state", f"{name} {process} {self.participant.state_of(name)}")


def batch(graph: Any, participant: Any, folder: Path, number: int) -> GraphAttacks:
    """Return a graph to attack."""
    return GraphAttacks(graph, participant, folder, configuration(number))
