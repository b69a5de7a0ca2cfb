"""Strangers: rigs, rig files and recordings that share nothing with the package, in all modes.

    python -m benchmarks.strangers --count 40 --seed 7              # identify, diagnose, diagnose --baseline, monitor
    python -m benchmarks.strangers --seed 7 --case 12               # one of them, with the complete answers
    python -m benchmarks.strangers --seed 7 --case 12 --keep DIR    # and with its files: recordings, rig file, columns
    python -m benchmarks.strangers --summary runs/strangers-7.jsonl

Each stranger is a whole rig drawn from the seed; its rig file is the first draft of `ehls new-rig` from data sheets. Three
recordings of 30 s are made: two of the healthy rig, one after a hidden change; one in four has none. Every stranger is written
as a line of JSON when it is done; an interrupted run is resumed.
"""

import os

# One thread a process: times are those of one thread, and jobs do not disturb each other.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse  # noqa: E402
import secrets  # noqa: E402
import sys  # noqa: E402
from functools import partial  # noqa: E402
from pathlib import Path  # noqa: E402

from rich.console import Console  # noqa: E402

from benchmarks.common import ROOT, parser_of  # noqa: E402
from benchmarks.rows import appended, as_json, read_rows, run_all  # noqa: E402
from benchmarks.strangers import tables  # noqa: E402
from benchmarks.strangers.running import MODES, run  # noqa: E402

WIDTH = 240
"""Width of the tables if the output is not a terminal."""


def arguments() -> argparse.Namespace:
    """Return the command line."""
    parser = parser_of(__doc__)
    parser.prog = "python -m benchmarks.strangers"
    parser.add_argument("--count", type=int, default=40, help="number of strangers (%(default)s)")
    parser.add_argument("--seed", type=int, help="seed of the strangers; a fresh one by default")
    parser.add_argument("--jobs", type=int, default=1, help="processes (%(default)s)")
    parser.add_argument("--modes", nargs="+", choices=MODES, default=list(MODES), help="modes to run (all)")
    parser.add_argument("--case", type=int, nargs="+", help="only these, with their complete answers; nothing is written")
    parser.add_argument("--keep", type=Path, help="with --case: folder that keeps the files")
    parser.add_argument("--out", type=Path, help="file of results, one line each (runs/strangers-SEED.jsonl)")
    parser.add_argument("--summary", type=Path, nargs="+", help="print the tables of such files without running anything")
    return parser.parse_args()


def main() -> None:
    """Run the strangers and print the tables."""
    options = arguments()
    console = Console() if sys.stdout.isatty() else Console(width=WIDTH)
    if options.summary:
        tables.show(read_rows(options.summary), console)
        return
    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    one = partial(run, seed, modes=tuple(options.modes))
    if options.case:
        for number in options.case:
            folder = options.keep / str(number) if options.keep else None
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
            row = one(number, folder=folder)
            console.print_json(as_json(row))
            tables.show([row], console)
        return
    out = options.out or ROOT / "runs" / f"strangers-{seed}.jsonl"
    out.parent.mkdir(parents=True, exist_ok=True)
    rows = read_rows([out])
    if any(row["seed"] != seed for row in rows):
        sys.exit(f"{out} holds other strangers; name another file with --out")
    done = {row["number"] for row in rows}
    left = [number for number in range(options.count) if number not in done]
    print(f"seed {seed}, {options.count} strangers, {len(left)} to do, into {out}", flush=True)
    for row in appended(out, run_all(one, left, options.jobs)):
        rows.append(row)
        print(tables.line_of(row), flush=True)
    tables.show([row for row in rows if row["number"] < options.count], console)


if __name__ == "__main__":
    main()
