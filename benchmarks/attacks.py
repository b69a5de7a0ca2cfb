"""Thousands of random sequences of attacks on a running bridge and emulated rig at 1 kHz, checked against the rig's log.

    python benchmarks/attacks.py --sequences 2000 --seed 1

After each batch of sequences the log is evaluated and the processes are restarted. The table has the extremes of each batch. A
broken rule ends the run with code 1 and leaves the batch's folder.
"""

import argparse
import os
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "test" / "nodes"))
sys.path.append(str(Path(__file__).resolve().parents[1] / "test"))

from commanded_rig import FAST, CommandedRig
from conftest import Graph, Participant
from random_attacks import LARGEST, RandomAttacks, Worst, judge

from ehls_ros.nodes.graph import free_domain
from ehls_ros.nodes.shared_memory import leftovers

BATCH = 50
"""Sequences between two restarts."""

SPEED, FORCE, POSITION = 2.0, 1.82e4, 0.3
"""The rig's limits [m/s, N, m]."""

RESOLUTION = 1e-6
"""Resolution of the converter [m]."""


def run_batch(folder: Path, seed: int, sequences: int) -> tuple[Worst, RandomAttacks]:
    """Run some sequences on fresh processes."""
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    graph, participant = Graph(folder), Participant()
    rig = CommandedRig(graph, participant, folder, FAST)
    try:
        rig.open()
        attacks = RandomAttacks(rig, random.Random(seed))  # noqa: S311
        for _ in range(sequences):
            attacks.sequence()
        attacks.emergency_stop()
        participant.rest(0.2)
        attacks.end_of_null()
        return judge(rig.seen(), FAST, attacks.closed), attacks
    finally:
        rig.close()
        for name in list(graph.processes):
            graph.stop(name)
        participant.close()
        for file in leftovers():
            file.unlink(missing_ok=True)


def broken(worst: Worst) -> list[str]:
    """Return the rules that a batch broke."""
    rules = {
        "a command beyond the largest": worst.command <= LARGEST,
        "open while it had to be at null": worst.open_when_closed == 0.0,
        "opened faster than its ramp": worst.beyond_ramp <= RESOLUTION,
        "speed": worst.speed <= SPEED,
        "force": worst.force <= FORCE,
        "position": worst.position <= POSITION,
    }
    return [rule for rule, kept in rules.items() if not kept]


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(2**32))
    options = parser.parse_args()
    print(f"seed {options.seed}, {options.sequences} sequences, batches of {BATCH}")
    columns = ("command um", "closed um", "ramp um", "step um", "speed m/s", "force N", "position m", "open %")
    print("| sequences | seed | " + " | ".join(columns) + " | nulls | s |\n|" + "---|" * 12)
    done, actions, worsts, nulls = 0, Counter[str](), [], 0
    begun = time.monotonic()
    for number in range(-(-options.sequences // BATCH)):
        seed, count = options.seed + number, min(BATCH, options.sequences - done)
        folder = Path(tempfile.mkdtemp(prefix="random_attacks_"))
        since = time.monotonic()
        worst, attacks = run_batch(folder, seed, count)
        done += count
        actions += attacks.done
        nulls += len(attacks.closed)
        worsts.append(worst)
        print(line(str(done), str(seed), worst, len(attacks.closed), time.monotonic() - since), flush=True)
        if wrong := broken(worst):
            print(f"broken in {folder}: {', '.join(wrong)}")
            return 1
        for path in folder.iterdir():
            path.unlink()
        folder.rmdir()
    whole = Worst(*map(max, zip(*worsts, strict=True)))
    print(line("all", "", whole, nulls, time.monotonic() - begun))
    print(", ".join(f"{name} {count}" for name, count in actions.most_common()))
    return 0


def line(sequences: str, seed: str, worst: Worst, nulls: int, seconds: float) -> str:
    """Return a line of the table."""
    lengths = (worst.command, worst.open_when_closed, worst.beyond_ramp, worst.step)
    cells = [
        *(f"{1e6 * length:.1f}" for length in lengths),
        f"{worst.speed:.3f}",
        f"{worst.force:.0f}",
        f"{worst.position:.3f}",
    ]
    return (
        f"| {sequences} | {seed} | " + " | ".join([*cells, f"{100.0 * worst.opened:.0f}", str(nulls), f"{seconds:.0f}"]) + " |"
    )


if __name__ == "__main__":
    sys.exit(main())
