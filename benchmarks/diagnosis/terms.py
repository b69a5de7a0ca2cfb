"""Effects on no list: the terms that a diagnosis finds for them, and their gain on data to which they were not fitted.

    python -m benchmarks.diagnosis.terms --seed 7 --rounds 2     # every effect outside the list, twice

Each case is a rig of truth_generator with one effect of its ``OUTSIDE``; the rig file is right otherwise. *Held out* is the
part of the removable error that the term closes in blocks to which it was not fitted, *carried over* the same in another
recording with another motion.
"""

import secrets
from functools import partial
from typing import Any

import numpy as np

from benchmarks.common import parser_of
from benchmarks.diagnosis.cases import rig, rig_file, trajectory_of
from ehls_ros.diagnosis.carried_over import carried_over
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.parallel import Workers
from ehls_ros.report.diagnosis_term import phrase
from truth_generator import OUTSIDE, draw_effect, record

OTHER = "random"
"""Experiment of the other recording."""

CLOSED, CARRIED, SURE = 0.8, 0.7, 0.9
"""Parts of an error closed from which a term counts, held out and carried over; probability of a wrong name that counts."""


def case(name: str, seed: int, duration: float) -> dict[str, Any]:
    """Run one case and return its row."""
    random = np.random.default_rng(seed)
    sizes = draw_effect(name, random, rig_file())
    first, other = (
        trajectory_of(record(rig_file(), {name: sizes}, experiment, seed=seed + k, duration=duration))
        for k, experiment in enumerate(("rich", OTHER))
    )
    found = diagnose(first, rig(), name, threads=1)
    row: dict[str, Any] = {"name": name, "stage": OUTSIDE[name].stage, "verdict": found.verdict, "found": found.unknown_stage}
    row["wrong"] = [c.name for c in found.causes if c.probability > SURE and c.name not in OUTSIDE[name].near]
    row["wall_s"] = found.wall_s
    if found.term is not None:
        carried = None if found.gain is None else carried_over(found, other, "other").get(found.gain.channel)
        row |= {
            "term": phrase(found.term),
            "closed": 0.0 if found.gain is None else found.gain.closed_fraction,
            "carried": None if carried is None else carried.closed,
        }
    return row


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=None, help="seed of the cases; a fresh one by default")
    parser.add_argument("--rounds", type=int, default=2, help="cases of each effect (%(default)s)")
    parser.add_argument("--duration", type=float, default=30.0, help="of each recording, s (%(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (%(default)s)")
    options = parser.parse_args()
    seed = secrets.randbits(24) if options.seed is None else options.seed
    drawn = [(name, seed + 1000 * k + i) for k in range(options.rounds) for i, name in enumerate(OUTSIDE)]
    print(f"seed {seed}, {len(drawn)} cases of {options.duration:g} s", flush=True)
    with Workers(options.jobs) as workers:
        rows: list[dict[str, Any]] = workers.run([partial(case, name, own, options.duration) for name, own in drawn])
    for row in rows:
        gain = f"{row['closed']:7.1%} {row['carried'] or 0.0:7.1%}" if "term" in row else f"{'':15}"
        said = row.get("term", ", ".join(row["wrong"]))
        print(f"{row['name']:26} {row['verdict']:9} {row['found'] or '–':14} {gain}  {said}")
    unknown = [row for row in rows if row["verdict"] == "unknown"]
    terms = [row for row in rows if "term" in row]
    closed, carried = (
        sum((row[key] or 0.0) >= least for row in terms) for key, least in (("closed", CLOSED), ("carried", CARRIED))
    )
    times = [row["wall_s"] for row in rows]
    print(f"unknown {len(unknown)} of {len(rows)}, in the right stage {sum(row['found'] == row['stage'] for row in unknown)}")
    print(f"with a term {len(terms)}: held out it closes {CLOSED:.0%} in {closed}, carried over {CARRIED:.0%} in {carried}")
    print(f"a wrong cause is named with more than {SURE:.0%} in {sum(bool(row['wrong']) for row in rows)}")
    print(f"time: median {np.median(times):.1f} s, largest {max(times):.1f} s")


if __name__ == "__main__":
    main()
