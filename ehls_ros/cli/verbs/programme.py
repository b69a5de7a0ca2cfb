"""`ehls programme`: check a test programme and summarise its contents."""

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path

from ehls_ros.cli.arguments import add_configured, add_json
from ehls_ros.cli.results import writable
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.programme_summary import Counts, Summary, counted, in_bins, summary_of
from ehls_ros.experiments.reference_files import load_programme
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.experiments.spec import load_rig
from ehls_ros.recording.load import load
from ehls_ros.report.page import number
from ehls_ros.report.programme import write_programme_report

HELP = "Check a test programme: its blocks, durations, load cycles, rates against the rig's limits, and rainflow counts."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    add_configured(parser, "programme", "programmes", "programme's file (YAML), or a name such as fatigue")
    parser.add_argument("--rig", default="rig_paper", help="rig whose limits it is compared with (default: rig_paper)")
    parser.add_argument(
        "--counted", type=Path, metavar="RUN", help="also count the recorded force of a run folder, bag or table"
    )
    parser.add_argument("--out", type=Path, help="HTML file with a picture of it")
    add_json(parser, "the summary")


def run(options: Namespace) -> int:
    """Run it."""
    programme = load_programme(options.programme)
    summary = summary_of(programme, load_rig(configured(options.rig)))
    if options.counted is not None:
        trajectory = load(recording_in(options.counted))
        summary = summary._replace(recorded=counted(trajectory, str(options.counted)))
    _print(summary)
    if options.out is not None:
        writable(options.out.parent, options.out.name)
        write_programme_report(programme, summary, options.out)
        print(f"  picture             {options.out}")
    if options.json:
        print(json.dumps(json_document(summary)))
    return 0


def _print(summary: Summary) -> None:
    print(summary.title)
    print(f"  duration            {number(summary.duration_s)} s")
    print(f"  load cycles         {number(summary.load_cycles)}")
    print(
        f"  largest rate        {number(summary.largest_rate_n_s)} N/s; the rig reaches {number(summary.possible_rate_n_s)} N/s"
    )
    print(f"  automatic ramps     {number(summary.ramps)}, where a block begins at another value than the programme stands at")
    header = ("block", "kind", "passes", "load cycles", "time [s]", "peak [N]", "valley [N]", "rate [N/s]")
    print(f"  {header[0]:<20}{header[1]:<10}" + "".join(f"{title:>13}" for title in header[2:]))
    for block in summary.blocks:
        cells = (block.passes, block.load_cycles, block.duration_s, block.peak_n, block.valley_n, block.largest_rate_n_s)
        print(f"  {block.name:<20}{block.kind:<10}" + "".join(f"{number(cell):>13}" for cell in cells))
    for heading, counts in (
        ("rainflow of the programme", summary.rainflow),
        ("rainflow of the recorded force", summary.recorded),
    ):
        if counts is not None:
            _print_counts(heading, counts)
    for complaint in summary.complaints:
        print(f"  ! {complaint}")


def _print_counts(heading: str, counts: Counts) -> None:
    print(f"  {heading}: range and mean [N], cycles")
    for size, mean, cycles in in_bins(counts):
        print(f"  {number(size):>14}{number(mean):>14}{number(cycles, 6):>14}")
