"""The dashboard's server on a stand-in graph: `python stand_in.py HOST` serves until SIGINT.

It prints the page's address, then a line for every request that reaches the graph. A line of JSON on its input sets the nodes'
diagnostics: a list of [node, level, message, figures]. A mapping sets a monitor's report, the fields of RigHealth, or under
"snapshot" some fields of the snapshot.
"""

import json
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from ehls_ros.dashboard.graph import (
    Answer,
    GraphSnapshot,
    NodeHealth,
    RigChange,
    RigCoefficient,
    RigHealth,
    Timing,
    Tunable,
    Tuning,
    Value,
)
from ehls_ros.dashboard.panels import SIGNALS
from ehls_ros.dashboard.server import listening, serve
from ehls_ros.dashboard.window import Window
from ehls_ros.schema import fitted

CYCLES = 20_000


class StandIn:
    """A graph that only prints the requests it gets."""

    def __init__(self) -> None:
        self.window = Window(tuple(SIGNALS))
        self.where = "made up"
        self.simulated = True
        cycle = np.arange(CYCLES)
        self.window.add(1e-3 * cycle, dict.fromkeys(SIGNALS, np.sin(1e-3 * cycle)))
        # A closed gate, so that there is a button that opens it: those that are not shown do nothing.
        self._health = (NodeHealth("plant_sim_node", 0, "disabled", {"state": "disabled", "owner": "nobody"}),)
        self._rig: RigHealth | None = None
        self._more: dict[str, Any] = {"laws": ("fasmc",)}

    def listen(self) -> None:
        for line in sys.stdin:
            said = json.loads(line)
            if isinstance(said, dict) and "snapshot" in said:
                kinds = {"tuning": Tuning | None, "laws": tuple[str, ...], "on_rig": bool}
                self._more = {name: fitted(kinds[name], value) for name, value in said["snapshot"].items()}
            elif isinstance(said, dict):
                self._rig = _rig_health(said)
            else:
                self._health = tuple(NodeHealth(*node) for node in said)

    def snapshot(self) -> GraphSnapshot:
        return GraphSnapshot(rate=1000.0, period=1e-3, health=self._health, started_here=True, rig=self._rig, **self._more)

    def tunable_nodes(self) -> tuple[str, ...]:
        return ("fasmc_node",)

    def parameters(self, node: str) -> tuple[Tunable, ...]:
        return (Tunable("k", 12.0, "slope [1]", 0.0, 100.0),)

    def set_parameter(self, node: str, name: str, value: Value) -> Answer:
        return self._request(f"{name} = {value}")

    def emergency_stop(self) -> Answer:
        return self._request("emergency stop")

    def acknowledge_stop(self) -> Answer:
        return self._request("acknowledge stop")

    def acknowledge_changes(self) -> Answer:
        return self._request("acknowledge changes")

    def unload(self) -> Answer:
        return self._request("unload")

    def reset_trips(self) -> Answer:
        return self._request("reset trips")

    def enable(self) -> Answer:
        return self._request("enable")

    def reset_and_enable(self) -> Answer:
        return self._request("reset and enable")

    def programme(self, request: str) -> Answer:
        return self._request(f"programme {request}")

    def start(self, spec: Any, name: str, timing: Timing) -> Answer:
        return self._request("start")

    def stop(self) -> Answer:
        return self._request("stop")

    def record(self, *, on: bool) -> Answer:
        return self._request("record")

    def evaluate(self, verb: str) -> Answer:
        return self._request(verb)

    def tune(self, spec: Any, name: str) -> Answer:
        return self._request("tune")

    def cancel_tuning(self) -> Answer:
        return self._request("cancel tuning")

    def apply_tuning(self, folder: str, *, confirmed: bool) -> Answer:
        return self._request(f"apply {folder}{' to a rig' if confirmed else ''}")

    def document(self, name: str) -> Path | None:
        return Path(__file__) if name == "report" else None

    def abort(self) -> None:
        pass

    def _request(self, request: str) -> Answer:
        # In one piece: two threads may print at once.
        sys.stdout.write(f"request: {request}\n")
        sys.stdout.flush()
        return Answer(done=True, message=request)


def _rig_health(said: dict[str, Any]) -> RigHealth | None:
    changes = tuple(RigChange(*change) for change in said.pop("changes", ()))
    coefficients = tuple(RigCoefficient(*coefficient) for coefficient in said.pop("coefficients", ()))
    return RigHealth(**said, changes=changes, coefficients=coefficients) if said else None


if __name__ == "__main__":
    graph = StandIn()
    threading.Thread(target=graph.listen, daemon=True).start()
    with listening(sys.argv[1], 0) as opened:
        serve(graph, opened, None, Timing.LOCKSTEP, lambda address: print(address, flush=True))
