"""Hidden cases for the diagnosis: its accuracy and speed, compared with simpler methods on the same cases.

    python -m benchmarks.diagnosis --cases 400 --jobs 2          # a fresh seed, which is printed
    python -m benchmarks.diagnosis --exam partial --cases 200    # rigs that no model describes; or another exam
    python -m benchmarks.diagnosis --rig single_rod --signals one_pressure    # a single rod, with one pressure only
    python -m benchmarks.diagnosis --seed 7                      # the same cases again, or those still missing
    python -m benchmarks.diagnosis --seed 7 --case 12 31         # two of them, with the complete results
    python -m benchmarks.diagnosis --summary runs/diagnosis-7.jsonl
    python -m benchmarks.diagnosis --tune                        # the peers' thresholds, on seeds of their own

The cases come from truth_generator, which shares no code with ehls_ros. Each case is written as a line of JSON when it is done;
an interrupted run is resumed. `make setup WITH=peers` installs pysindy, a peer that ehls_ros does not need.
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
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn  # noqa: E402

from benchmarks.common import ROOT, parser_of  # noqa: E402
from benchmarks.diagnosis import cases, running, tables  # noqa: E402
from benchmarks.diagnosis.exams import EXAMS, numbers  # noqa: E402
from benchmarks.diagnosis.judge import judge  # noqa: E402
from benchmarks.rows import Row, appended, as_json, read_rows, run_all  # noqa: E402

WIDTH = 220
"""Width of the tables if the output is not a terminal."""

QUICK_CASES, QUICK_DURATION = 40, 20.0


def arguments() -> argparse.Namespace:
    """Return the command line."""
    parser = parser_of(__doc__)
    parser.prog = "python -m benchmarks.diagnosis"
    exams = [name for name in EXAMS if " " not in name]
    parser.add_argument("--rig", choices=cases.RIGS, default="paper", help="the rig (%(default)s)")
    parser.add_argument("--signals", choices=("all", "one_pressure"), default="all", help="of a single rod (%(default)s)")
    parser.add_argument("--exam", choices=exams, default="clean", help="what the rig and its recordings are like (%(default)s)")
    parser.add_argument("--cases", type=int, default=None, help="number of cases (400)")
    parser.add_argument("--seed", type=int, default=None, help="seed of the cases; a fresh one by default")
    parser.add_argument("--jobs", type=int, default=2, help="processes (%(default)s)")
    parser.add_argument("--only", choices=cases.KINDS, help="cases of this kind only")
    parser.add_argument("--case", type=int, nargs="+", help="only these cases, with their complete results; nothing is written")
    parser.add_argument("--duration", type=float, default=None, help="duration of the recordings, s (60)")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_CASES} cases of {QUICK_DURATION:g} s")
    parser.add_argument("--no-peers", action="store_true", help="leave the peers out")
    parser.add_argument("--out", type=Path, help="file of results, one line per case (runs/diagnosis-SEED.jsonl)")
    parser.add_argument("--summary", type=Path, nargs="+", help="print the tables of such files without running anything")
    parser.add_argument("--tune", action="store_true", help="tune the peers' thresholds on separate seeds")
    return parser.parse_args()


def bar(console: Console) -> Progress:
    """Return the progress bar."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, disable=not console.is_terminal)


def line_of(row: Row) -> str:
    """Return a case in one line, for output that is not a terminal."""
    j = judge(row)
    took = f"{row['ours']['wall_s']:5.1f} s" if "ours" in row else "      –"
    hidden = " + ".join(row.get("hidden", {})) or "nothing"
    return f"{'ok   ' if j.right else 'WRONG'} {row['number']:4d} {took}  {hidden} -> {j.what}"


def main() -> None:
    """Run the cases and print the tables."""
    options = arguments()
    console = Console() if sys.stdout.isatty() else Console(width=WIDTH)
    errors = Console(stderr=True)
    if options.summary:
        tables.show(read_rows(options.summary), console)
        return
    if options.tune:
        from benchmarks.diagnosis.tune import tune  # noqa: PLC0415

        tune(console)
        return
    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    duration = options.duration or (QUICK_DURATION if options.quick else 60.0)
    if options.signals != "all":
        options.exam = options.signals if options.exam == "clean" else f"{options.exam} with {options.signals}"
    options.exam = cases.name_of(options.exam, options.rig)
    if options.exam not in EXAMS:
        sys.exit(f"--exam {options.exam}: there is none; there are {', '.join(EXAMS)}")
    with_peers = options.exam == "clean" and not options.no_peers  # the peers assume that the rig is the model
    one = partial(running.run, options.exam, seed, duration=duration, with_peers=with_peers)
    if options.case:
        for row in run_all(one, options.case, 1):
            console.print_json(as_json(row))
            console.print(tables.failures([(row, judge(row))]))
        return
    if options.only not in (None, *EXAMS[options.exam].kinds):
        sys.exit(f"--only {options.only}: the exam '{options.exam}' has {', '.join(EXAMS[options.exam].kinds)}")
    wanted = numbers(options.exam, options.cases or (QUICK_CASES if options.quick else 400), options.only)
    exam = "" if options.exam == "clean" else f"-{options.exam.replace(' ', '-')}"
    out = options.out or ROOT / "runs" / f"diagnosis{exam}-{seed}.jsonl"
    out.parent.mkdir(parents=True, exist_ok=True)
    rows = read_rows([out])
    this = (options.exam, seed, duration)
    if other := {(r.get("exam", "clean"), r["seed"], r.get("duration", duration)) for r in rows} - {this}:
        sys.exit(f"{out} holds other cases (exam, seed, duration: {sorted(other)}); name another file with --out")
    done = {r["number"] for r in rows}
    left = [number for number in wanted if number not in done]
    print(f"seed {seed}, {len(wanted)} cases of {duration:g} s, {len(left)} to do, into {out}", flush=True)
    with bar(errors) as progress:
        task = progress.add_task("cases", total=len(wanted), completed=len(wanted) - len(left))
        for row in appended(out, run_all(one, left, options.jobs)):
            rows.append(row)
            if errors.is_terminal:
                right = sum(judge(r).right for r in rows)
                progress.update(task, advance=1, description=f"{right} of {len(rows)} right")
            else:
                print(line_of(row), flush=True)
    tables.show([r for r in rows if r["number"] in set(wanted)], console)


if __name__ == "__main__":
    main()
