"""Effects on no list: the terms that a diagnosis finds for them, and their gain on data to which they were not fitted.

    python -m benchmarks.diagnosis.terms --seed 7 --rounds 2     # every effect outside the list, twice
    python -m benchmarks.diagnosis.terms --seed 7 --only detent cavitation

Each case is a rig of truth_generator with one effect of its ``OUTSIDE``; the rig file is right otherwise. *Held out* is the
part of the removable error that the term closes in blocks to which it was not fitted, *carried over* the same in another
recording with another motion, and *free run* the part of the error that it closes when the recording is simulated from its
start. The signals and the shape of a term are compared with :mod:`~benchmarks.diagnosis.term_truth`.
"""

import secrets
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.common import parser_of
from benchmarks.diagnosis.cases import rig, rig_file, trajectory_of
from benchmarks.diagnosis.term_truth import TRUTHS, signals_right
from ehls_ros.diagnosis.carried_over import carried_over
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.free_run import free_run
from ehls_ros.diagnosis.loss import rms
from ehls_ros.diagnosis.result import Diagnosis
from ehls_ros.parallel import Workers
from ehls_ros.report.diagnosis_term import phrase
from ehls_ros.trajectory import Trajectory
from truth_generator import OUTSIDE, draw_effect, record

OTHER = "random"
"""Experiment of the other recording."""

CLOSED, CARRIED, SURE = 0.8, 0.7, 0.9
"""Parts of an error closed from which a term counts, held out and carried over; probability of a wrong name that counts."""

Row = dict[str, Any]


def case(name: str, seed: int, duration: float) -> Row:
    """Run one case, print its row and return it."""
    random = np.random.default_rng(seed)
    sizes = draw_effect(name, random, rig_file())
    first, other = (
        trajectory_of(record(rig_file(), {name: sizes}, experiment, seed=seed + k, duration=duration))
        for k, experiment in enumerate(("rich", OTHER))
    )
    found = diagnose(first, rig(), name, threads=1)
    row: Row = {"name": name, "stage": OUTSIDE[name].stage, "verdict": found.verdict, "found": found.unknown_stage}
    row["wrong"] = [c.name for c in found.causes if c.probability > SURE and c.name not in OUTSIDE[name].near]
    row["said"] = " + ".join(f"{c.name} {c.probability:.0%}" for c in found.causes)
    row["wall_s"] = found.wall_s
    if found.term is not None:
        carried = None if found.gain is None else carried_over(found, other, "other").get(found.gain.channel)
        truth = TRUTHS[name]
        row |= {
            "term": phrase(found.term),
            "closed": 0.0 if found.gain is None else found.gain.closed_fraction,
            # An error below the noise is none to close.
            "carried": None if carried is None or carried.noise > 1.0 else carried.closed,
            "free": closed_in_free_run(found, first),
            "signals": signals_right(found.term, truth),
            "reads": None if truth.reads is None else truth.reads(found.term, sizes),
        }
    print(_line(row), flush=True)
    return row


def closed_in_free_run(found: Diagnosis, recorded: Trajectory) -> float | None:
    """Return the part of the free run's error that the extended model closes; None if the given model leaves the stroke.

    The error is the rms of all signals' errors in units of their standard deviations. An extended model that leaves the stroke
    closes nothing.
    """
    run = free_run(recorded, found.rig, found.extended)
    before = [s.nrmse_before for s in run.signals if s.nrmse_before is not None]
    after = [s.nrmse_after for s in run.signals if s.nrmse_after is not None]
    if not before:
        return None
    return 1.0 - rms(np.array(after)) / rms(np.array(before)) if after else 0.0


def _line(row: Row) -> str:
    """Return a case's line of the table."""
    if "term" not in row:
        return f"{row['name']:26} {row['verdict']:9} {row['found'] or '–':14} {'':31} {row['said']}"
    gains = " ".join("      –" if row[key] is None else f"{row[key]:7.1%}" for key in ("closed", "carried", "free"))
    right = ("s" if row["signals"] else "-") + {True: "r", False: "-", None: " "}[row["reads"]]
    beside = f", beside {row['said']}" if row["said"] else ""
    return f"{row['name']:26} {row['verdict']:9} {row['found'] or '–':14} {gains} {right:7} {row['term']}{beside}"


def summary(rows: Sequence[Row]) -> list[str]:
    """Return the figures of all cases, a line each."""
    unknown = [row for row in rows if row["verdict"] == "unknown"]
    terms = [row for row in rows if "term" in row]
    stages = sum(row["found"] == row["stage"] for row in unknown)
    free = [row["free"] for row in terms if row["free"] is not None]
    times = [row["wall_s"] for row in rows]
    return [
        f"unknown {len(unknown)} of {len(rows)}, in the right stage {stages}",
        f"with a term {len(terms)}, over the right signals {sum(row['signals'] for row in terms)}",
        f"held out, it closes {CLOSED:.0%} in {_reached(terms, 'closed', CLOSED)}",
        f"carried over, it closes {CARRIED:.0%} in {_reached(terms, 'carried', CARRIED)}",
        f"free run, part closed in the median: {np.median(free):.1%} of {len(free)}" if free else "no free run",
        f"shape right {sum(row['reads'] is True for row in terms)} of {sum(row['reads'] is not None for row in terms)}",
        f"a wrong cause is named with more than {SURE:.0%} in {sum(bool(row['wrong']) for row in rows)}",
        f"time: median {np.median(times):.1f} s, largest {max(times):.1f} s",
    ]


def _reached(rows: Sequence[Mapping[str, Any]], key: str, least: float) -> str:
    """Return how many rows reach a part closed, of those that have an error to close."""
    known = [row[key] for row in rows if row[key] is not None]
    return f"{sum(value >= least for value in known)} of {len(known)}"


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=None, help="seed of the cases; a fresh one by default")
    parser.add_argument("--rounds", type=int, default=2, help="cases of each effect (%(default)s)")
    parser.add_argument("--duration", type=float, default=30.0, help="of each recording, s (%(default)s)")
    parser.add_argument("--only", nargs="+", choices=list(OUTSIDE), default=list(OUTSIDE), help="effects (default: all)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (%(default)s)")
    options = parser.parse_args()
    seed = secrets.randbits(24) if options.seed is None else options.seed
    every = [(name, seed + 1000 * k + i) for k in range(options.rounds) for i, name in enumerate(OUTSIDE)]
    drawn = [(name, own) for name, own in every if name in options.only]
    print(f"seed {seed}, {len(drawn)} cases of {options.duration:g} s", flush=True)
    print("effect, verdict, stage; closed held out, carried over and in the free run; s: signals right, r: shape right")
    with Workers(options.jobs) as workers:
        rows: list[Row] = workers.run([partial(case, name, own, options.duration) for name, own in drawn])
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
