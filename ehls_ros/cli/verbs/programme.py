"""`ehls programme`: check a test programme and summarise its contents; stop, resume or skip in a running one."""

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from ehls_ros.cli.arguments import Configured, add_configured, add_json, add_namespace, needs_ros
from ehls_ros.cli.results import writable
from ehls_ros.cli.verbs import experiment
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.programme.expansion import programme_of
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.programme_summary import Counts, Summary, counted, in_bins, summary_of
from ehls_ros.experiments.reference_files import load_programme
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.experiments.spec import check_spec, load_rig, spec_from_mapping
from ehls_ros.recording.load import load
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.report.page import number
from ehls_ros.report.programme import write_programme_report

HELP = (
    "Check a test programme: its blocks, durations, load cycles, rates against the rig's limits, and rainflow counts. Or stop,"
    " resume, skip or show the one that runs, without `ros2`."
)

REQUESTS = {
    "stop": "stop the running programme",
    "resume": "resume it",
    "skip": "go on at its next block",
    "status": "show its block, load cycles and state, and the reason for a stop",
}
"""Words in place of a file, and their help; a file of that name is given as ./stop."""


class _FileOrRequest(Configured):
    """A programme's file, or one of :data:`REQUESTS`."""

    def __call__(self, parser: ArgumentParser, namespace: Namespace, values: object, option_string: str | None = None) -> None:
        """Store the request or the resolved path."""
        if str(values) in REQUESTS:
            setattr(namespace, self.dest, str(values))
        else:
            super().__call__(parser, namespace, values, option_string)


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    words = "; ".join(f"{request}: {about}" for request, about in REQUESTS.items())
    parser.add_argument(
        "programme",
        type=Path,
        action=_FileOrRequest,
        folder="programmes",
        metavar=f"PROGRAMME|{'|'.join(REQUESTS)}",
        help=f"programme's file (YAML), or a name such as fatigue; or a request to the programme node: {words}",
    )
    add_namespace(parser)
    parser.add_argument("--rig", default="rig_paper", help="rig whose limits it is compared with (default: rig_paper)")
    parser.add_argument(
        "--counted", type=Path, metavar="RUN", help="also count the recorded force of a run folder, bag or table"
    )
    parser.add_argument("--out", type=Path, help="HTML file with a picture of it")
    parser.add_argument(
        "--run",
        nargs="?",
        type=Path,
        const=Path(),
        metavar="FOLDER",
        help="run it to its end on the graph, recorded in a run folder (default: runs/<programme>-<time>)",
    )
    add_configured(parser, "--spec", "experiments", "with --run: experiment whose rig, controller and disturbance are used")
    parser.add_argument(
        "--controller", choices=CONTROLLERS.names(), help="with --run: control law (default: the experiment's, otherwise fasmc)"
    )
    parser.add_argument("--overwrite", action="store_true", help="with --run: replace a run that FOLDER already holds")
    experiment.add_graph_options(parser.add_argument_group("with --run"))
    add_json(parser, "the summary")


def run(options: Namespace) -> int:
    """Check the file, or send the request."""
    if isinstance(options.programme, str):
        return _ask(options)
    if options.run is not None:
        return _run(options)
    programme = load_programme(options.programme)
    summary = summary_of(programme, load_rig(configured(options.rig)))
    if options.counted is not None:
        trajectory = load(recording_in(options.counted))
        summary = summary._replace(recorded=counted(trajectory, str(options.counted)))
    _print(summary, paced=programme.is_paced)
    if options.out is not None:
        writable(options.out.parent, options.out.name)
        write_programme_report(programme, summary, options.out)
        print(f"  picture             {options.out}")
    if options.json:
        print(json.dumps(json_document(summary)))
    return 0


def _run(options: Namespace) -> int:
    """Run the programme to its end on the graph."""
    file = str(options.programme)
    reference = {"name": "programme", "file": str(options.programme.resolve())}
    if options.spec is None:
        content: dict[str, Any] = {"rig": str(configured(options.rig).resolve()), "controller": options.controller or "fasmc"}
        spec = spec_from_mapping({**content, "reference": reference}, file, Path())
    else:
        content = {**read_yaml(options.spec, "spec"), "reference": reference}
        content |= {"controller": options.controller} if options.controller else {}
        spec = spec_from_mapping(content, str(options.spec), options.spec.parent)
    programme = programme_of(spec.reference.parameters)
    settings = spec.settings._replace(title=programme.parameters.title, duration=programme.duration)
    spec = spec._replace(settings=settings)
    check_spec(spec, file)
    options.out, options.in_process = options.run if options.run != Path() else None, False
    words = ["programme", file, "--run", *(["--spec", str(options.spec)] if options.spec else ["--rig", str(options.rig)])]
    words += ["--controller", options.controller] if options.controller else []
    return experiment.carry_out(spec, options, file, words, until_finished=True)


def _ask(options: Namespace) -> int:
    """Send a request to the running programme and print the answer."""
    from ehls_ros.dashboard.status import STOPPED_BECAUSE, programme_line

    with needs_ros():
        from ehls_ros.nodes.rig_requests import rig_requests
    with rig_requests(options.namespace) as rig:
        if options.programme == "status":
            report = rig.running_programme()
            content: Any = {**report.figures, "message": report.message}
            reason = report.figures.get(STOPPED_BECAUSE, "")
            text = f"{programme_line(report.figures)}{f': {reason}' if reason else ''}"
        else:
            text = rig.programme(options.programme)
            content = {"done": options.programme, "answer": text}
    print(json.dumps(content) if options.json else text)
    return 0


def _print(summary: Summary, *, paced: bool) -> None:
    print(summary.title)
    print(f"  duration            {number(summary.duration_s)} s{', longer by its pacing' if paced else ''}")
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
