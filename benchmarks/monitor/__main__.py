"""The monitor on simulated rigs: false alarms, delay and correct names, compared with simpler detectors, and its cost.

    python -m benchmarks.monitor healthy --hours 1000 --jobs 8       # hours of a healthy rig
    python -m benchmarks.monitor healthy --hours 100 --forms 0.01    # of one that is never its model
    python -m benchmarks.monitor hidden --cases 80                   # effects that begin while the rig runs
    python -m benchmarks.monitor hidden --cases 40 --drift           # that grow
    python -m benchmarks.monitor hidden --cases 40 --closed-loop     # under the adaptive controller, in the package's simulator
    python -m benchmarks.monitor peers --healthy FILE --hidden FILE  # simpler detectors; the first with --powers
    python -m benchmarks.monitor cost                                # time by part
    python -m benchmarks.monitor healthy --summary FILE…             # the tables of such files without running anything

Streams come from truth_generator, which shares no code with ehls_ros. Each episode or case is written as a line of JSON when it
is done; an interrupted run is resumed. `river`, whose drift detectors are peers, is not needed by ehls_ros.
"""

import os

# One thread a process: times are those of one thread, and jobs do not disturb each other.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse  # noqa: E402
import sys  # noqa: E402
from collections.abc import Callable  # noqa: E402
from functools import partial  # noqa: E402
from pathlib import Path  # noqa: E402

from rich.console import Console  # noqa: E402

from benchmarks.common import ROOT, parser_of  # noqa: E402
from benchmarks.diagnosis.cases import sources  # noqa: E402
from benchmarks.monitor import closed_loop, cost, healthy, hidden, peers, tables  # noqa: E402
from benchmarks.rows import Row, appended, read_rows, run_all  # noqa: E402

WIDTH = 200
"""Width of the tables if the output is not a terminal."""

PARTS = ("healthy", "hidden", "peers", "cost")


def arguments() -> argparse.Namespace:
    """Return the command line."""
    parser = parser_of(__doc__)
    parser.prog = "python -m benchmarks.monitor"
    parser.add_argument("part", choices=PARTS, help="what is measured")
    parser.add_argument("--seed", type=int, default=1, help="seed of the streams (%(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (%(default)s)")
    parser.add_argument("--hours", type=float, default=1.0, help="healthy: hours, episodes together (%(default)s)")
    parser.add_argument("--minutes", type=float, default=60.0, help="healthy: length of an episode (%(default)s)")
    parser.add_argument("--forms", type=float, help="healthy: largest form error, as a fraction of the largest terms")
    parser.add_argument("--powers", action="store_true", help="healthy: keep what `peers` needs, which takes as long again")
    parser.add_argument("--cases", type=int, default=40, help="hidden: number of cases, all effects in turn (%(default)s)")
    parser.add_argument("--drift", action="store_true", help="hidden: effects that grow")
    parser.add_argument("--closed-loop", action="store_true", help="hidden: under the adaptive controller")
    parser.add_argument("--healthy", type=Path, nargs="+", help="peers: results of `healthy`")
    parser.add_argument("--hidden", type=Path, nargs="+", help="peers: results of `hidden`")
    parser.add_argument("--out", type=Path, help="file of results (runs/monitor-PART-SEED.jsonl)")
    parser.add_argument("--summary", type=Path, nargs="+", help="print the tables of such files without running anything")
    return parser.parse_args()


def work(options: argparse.Namespace) -> tuple[str, Callable[[int], Row], int]:
    """Return the name of a run, the function that runs one of its numbers, and how many there are."""
    if options.part == "healthy":
        duration = 60.0 * options.minutes
        name = "healthy" if options.forms is None else f"healthy-forms{options.forms:g}"
        one = partial(healthy.run, options.seed, duration=duration, form=options.forms, with_powers=options.powers)
        return name, one, round(3600.0 * options.hours / duration)
    if options.closed_loop:
        return "closed-loop", partial(closed_loop.run, options.seed), options.cases
    if options.drift:
        return "drift", partial(hidden.run_growing, options.seed), options.cases
    return "hidden", partial(hidden.run, options.seed), options.cases


def main() -> None:
    """Run a part and print its tables."""
    options = arguments()
    console = Console() if sys.stdout.isatty() else Console(width=WIDTH)
    if options.part == "cost":
        cost.show(console)
        return
    if options.part == "peers":
        if not options.healthy or not options.hidden:
            sys.exit("peers: name results of `healthy` and of `hidden` with --healthy and --hidden")
        peers.show(read_rows(options.healthy), read_rows(options.hidden), console)
        return
    show = tables.show_healthy if options.part == "healthy" else tables.show_hidden
    if options.summary:
        show(read_rows(options.summary), console)
        return
    name, one, count = work(options)
    out = options.out or ROOT / "runs" / f"monitor-{name}-{options.seed}.jsonl"
    out.parent.mkdir(parents=True, exist_ok=True)
    rows = read_rows([out])
    if any(row["seed"] != options.seed or row.get("forms") != options.forms for row in rows):
        sys.exit(f"{out} holds another run; name another file with --out")
    done = {row["number"] for row in rows}
    left = [number for number in range(count) if number not in done]
    print(f"seed {options.seed}, {count} to run, {len(left)} to do, into {out}", flush=True)
    for row in appended(out, (row | {"sources": sources()} for row in run_all(one, left, options.jobs))):
        rows.append(row)
        print(tables.line_of(row), flush=True)
    show([row for row in rows if row["number"] < count], console)


if __name__ == "__main__":
    main()
