"""Thousands of attack sequences on running graphs, guided by their distance from violating a policy.

    python -m benchmarks.attacks --sequences 2000
    python -m benchmarks.attacks --sequences 200 --on bridge --seed 1 --blind

Three quarters of the sequences attack a bridge with its emulated rig at 1 kHz in real time. The others attack whole graphs in
lockstep, apart and composed, with programme, learning and second sources. After each batch its log is evaluated, sequences
that came closer are kept, and all processes are restarted. The table lists the policies: number of verdicts, violations, the
smallest robustness, and the sequence with it. A violation ends the run with code 1 and leaves the batch's folder.
"""

import os
import pickle
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "test" / "nodes"))
sys.path.append(str(Path(__file__).resolve().parents[1] / "test"))

import bridge_attacks
import graph_attacks
from commanded_rig import FAST, SLOW
from conftest import Graph, Participant
from guided import Attack, Kind, Search
from node_server import NodeServer
from policies.monitor import POLICIES, Verdict, judge
from policies.trace import Trace

from benchmarks.common import parser_of, print_heading, print_row
from ehls_ros.nodes.graph import free_domain
from ehls_ros.nodes.shared_memory import leftovers

BATCH = 20
"""Default number of sequences between two restarts."""


class Attacks(Protocol):
    """A running graph under attack.

    Attributes:
        done: number of times each action was taken.
        spans: beginning and end of each sequence [s].
    """

    done: Counter[str]
    spans: list[tuple[float, float]]

    def run(self, attack: Attack) -> None:
        """Carry out the actions of a sequence."""

    def trace(self) -> Trace:
        """End the run, and return its trace."""

    def close(self) -> None:
        """End all processes still running."""


class Arena(NamedTuple):
    """Target of the attacks.

    Attributes:
        name: for tables.
        kinds: its actions.
        begin: starts it, given a graph, a participant, a folder and the number of the batch.
    """

    name: str
    kinds: Mapping[str, Kind]
    begin: Callable[[Any, Any, Path, int], Attacks]


class Closest(NamedTuple):
    """Smallest robustness of a policy, and the sequence in which it occurred."""

    robustness: float
    sequence: str


class Campaign:
    """Sequences on one arena.

    Attributes:
        sequences: number of them so far.
        evaluated: instants by policy.
        violations: instants by policy.
        closest: by policy.
    """

    def __init__(self, arena: Arena, seed: int, *, blind: bool) -> None:
        """Start without known sequences."""
        self.arena = arena
        self.search = Search(random.Random(seed), arena.kinds, blind=blind)  # noqa: S311
        self.sequences, self.batches = 0, 0
        self.done, self.evaluated, self.violations = Counter[str](), Counter[str](), Counter[str]()
        self.closest: dict[str, Closest] = {}

    def batch(self, folder: Path, server: NodeServer, count: int) -> list[Verdict]:
        """Run some sequences on fresh processes, and learn from them; return the violated policies."""
        attacks, trace = self._run(folder, server, planned := [self.search.next() for _ in range(count)])
        verdicts = judge(trace)
        for (begin, end), attack in zip(attacks.spans, planned, strict=True):
            self.sequences += 1
            found = {name: robustness_in(verdict, begin, end) for name, verdict in verdicts.items()}
            self.search.learn(attack, {name: value for name, value in found.items() if np.isfinite(value)})
            for name, value in found.items():
                if value < self.closest.get(name, Closest(np.inf, "")).robustness:
                    said = f"{self.arena.name} {self.sequences}: {', '.join(map(str, attack))}"
                    self.closest[name] = Closest(value, said)
        for name, verdict in verdicts.items():
            self.evaluated[name] += verdict.evaluated
            self.violations[name] += verdict.violations
        self.done += attacks.done
        self.batches += 1
        violated = [verdict for verdict in verdicts.values() if verdict.violations]
        print_row(self.arena.name, self.sequences, late(trace), opened(trace), len(trace.calls), len(violated))
        if violated:
            with (folder / "trace.pickle").open("wb") as file:
                pickle.dump((trace, planned, attacks.spans), file)
        return violated

    def _run(self, folder: Path, server: NodeServer, planned: Sequence[Attack]) -> tuple[Attacks, Trace]:
        os.environ["ROS_DOMAIN_ID"] = str(free_domain())
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        graph, participant = Graph(folder, server), Participant()
        attacks = None
        try:
            attacks = self.arena.begin(graph, participant, folder, self.batches)
            for attack in planned:
                print(attack, file=(folder / "attacks.txt").open("a"))
                attacks.run(attack)
            return attacks, attacks.trace()
        finally:
            if attacks is not None:
                attacks.close()
            for process in graph.processes.values():
                process.kill()
                process.wait(60.0)
            participant.close()
            for file in leftovers():
                file.unlink(missing_ok=True)


def robustness_in(verdict: Verdict, begin: float, end: float) -> float:
    """Return a policy's smallest robustness in a period; infinite if it was not evaluated in it."""
    margins = verdict.margins
    return float(np.min(margins.margin[(margins.time >= begin) & (margins.time < end)], initial=np.inf))


def late(trace: Trace) -> str:
    """Return the lateness of the rig: its maximum, and the share of cycles late by more than a period [ms, 1/1000]."""
    if trace.setup.lockstep or not trace.moments.size:
        return "in lockstep"
    gaps = np.diff(trace.moments) - trace.setup.period
    return f"{1e3 * np.max(gaps):.0f} ms, {1e3 * np.mean(gaps > trace.setup.period):.2f} in 1000"


def opened(trace: Trace) -> str:
    """Return the fraction of time with the valve open [%]."""
    return f"{100.0 * np.mean(trace.open):.0f} %" if trace.command.size else ""


def table(campaigns: Sequence[Campaign]) -> str:
    """Return the table of policies."""
    lines = ["| policy | unit | evaluated | violations | smallest robustness | in |", "|---|---|---:|---:|---:|---|"]
    for policy in POLICIES:
        evaluated = sum(campaign.evaluated[policy.name] for campaign in campaigns)
        violations = sum(campaign.violations[policy.name] for campaign in campaigns)
        found = [campaign.closest[policy.name] for campaign in campaigns if policy.name in campaign.closest]
        closest = min(found, default=Closest(np.inf, "nothing"))
        unit = policy.formula.unit
        lines.append(f"| {policy.name} | {unit} | {evaluated} | {violations} | {closest.robustness:.4g} | {closest.sequence} |")
    return "\n".join(lines)


def main() -> int:
    """Run and print."""
    parser = parser_of(__doc__)
    parser.add_argument("--sequences", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(2**32))
    parser.add_argument("--batch", type=int, default=BATCH, help="sequences between two restarts: a generation of the search")
    parser.add_argument("--on", choices=("bridge", "graph", "both"), default="both")
    parser.add_argument("--slow", action="store_true", help="bridge at 100 Hz, which a busy computer can keep")
    parser.add_argument("--blind", action="store_true", help="draw all sequences anew, for comparison")
    parser.add_argument("--go-on", action="store_true", help="go on after a violation; the folders stay")
    options = parser.parse_args()
    pace = SLOW if options.slow else FAST

    def on_bridge(graph: Any, participant: Any, folder: Path, number: int) -> Attacks:
        return bridge_attacks.batch(graph, participant, folder, bridge_attacks.paced(pace, number))

    arenas = {
        "bridge": Arena("bridge", bridge_attacks.KINDS, on_bridge),
        "graph": Arena("graph", graph_attacks.KINDS, graph_attacks.batch),
    }
    chosen = ["bridge", "bridge", "bridge", "graph"] if options.on == "both" else [options.on]
    campaigns = {name: Campaign(arenas[name], options.seed, blind=options.blind) for name in dict.fromkeys(chosen)}
    way = "blind" if options.blind else "guided"
    print(f"seed {options.seed}, {options.sequences} {way} sequences, batches of {options.batch}")
    print_heading("on", "sequences", "rig late by", "valve open", "requests", "violated")
    begun, server, wrong = time.monotonic(), NodeServer(), 0
    try:
        done = 0
        while done < options.sequences and (options.go_on or not wrong):
            campaign = campaigns[chosen[done // options.batch % len(chosen)]]
            folder = Path(tempfile.mkdtemp(prefix="attacks_"))
            count = min(options.batch, options.sequences - done)
            violated = campaign.batch(folder, server, count)
            done += count
            for verdict in violated:
                print(f"violated in {folder}: {verdict}")
            wrong += bool(violated)
            if not violated:
                shutil.rmtree(folder)
    finally:
        server.close()
    print(f"\n{done} sequences in {(time.monotonic() - begun) / 60.0:.0f} minutes\n")
    print(table(list(campaigns.values())))
    for campaign in campaigns.values():
        print(f"\n{campaign.arena.name}: " + ", ".join(f"{name} {count}" for name, count in campaign.done.most_common()))
        print("pushed at: " + ", ".join(f"{name} {count}" for name, count in campaign.search.origins.most_common()))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
