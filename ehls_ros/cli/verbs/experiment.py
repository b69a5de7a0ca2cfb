"""`ehls experiment`: run one experiment, record it, evaluate it, write its report."""

import json
import math
import shlex
import sys
import time
from argparse import ArgumentParser, Namespace, _ActionsContainer
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from ehls_ros.cli.arguments import add_configured, add_json, add_plant, check_duration, check_plant, needs_ros
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.programme.expansion import programme_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments import learnt_files
from ehls_ros.experiments.adaptation_result import Adapted, adapted
from ehls_ros.experiments.causal_limit import with_causal_limit
from ehls_ros.experiments.compiling import announce_compiling, graph_jobs, loop_jobs
from ehls_ros.experiments.fmu_plant import fmu_plant, run_on_fmu
from ehls_ros.experiments.graph_check import Graph, bridge_at, check_fit
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.loop import run_as_far_as_it_goes
from ehls_ros.experiments.metrics import CONVERGENCE_BAND, Metrics, evaluate, stops_of
from ehls_ros.experiments.programme_records import STATE, read_state
from ehls_ros.experiments.real_rig import for_real_rig
from ehls_ros.experiments.run_failure import NodeFailed, RunFailed, with_failure
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import (
    Spec,
    company_of,
    for_simulated_rig,
    ignored_pacing,
    load_spec,
    swinging_actuator,
    undeclared_effects,
)
from ehls_ros.hardware.pace import ADVICE
from ehls_ros.progress import progress_bar
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import write_trajectory
from ehls_ros.recording.events import read_events
from ehls_ros.report.experiment import write_experiment_report
from ehls_ros.report.page import limit_text, number
from ehls_ros.trajectory import Trajectory, steady_error

HELP = "Run an experiment over DDS, record a bag, print metrics and write a report."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    add_configured(parser, "spec", "experiments", "experiment file (YAML), or a name such as sine_fd2")
    parser.add_argument("--out", type=Path, help="run folder (default: runs/<spec>-<time>)")
    parser.add_argument("--overwrite", action="store_true", help="replace a run that --out already holds")
    parser.add_argument("--in-process", action="store_true", help="run the same loop in one process, without ROS")
    parser.add_argument("--duration", type=float, help="plant time in s, in place of the spec's")
    add_graph_options(parser)
    add_json(parser, "the metrics")


def add_graph_options(parser: _ActionsContainer) -> None:
    """Add the options of a run on the graph, which `ehls programme --run` shares."""
    parser.add_argument(
        "--timing",
        choices=("lockstep", "realtime"),
        default="lockstep",
        help="lockstep: deterministic, as fast as possible; realtime: wall clock, last command held",
    )
    parser.add_argument(
        "--compose",
        action="store_true",
        help="run the nodes of a control cycle in one process, where a cycle is one call; by default each is a process",
    )
    add_plant(parser)
    parser.add_argument("--plant-fmu", type=Path, metavar="FILE", help="FMU that stands in place of the simulated rig")
    about = "YAML map of the FMU's variables and units; not needed for one of `ehls fmu` (with --plant-fmu)"
    parser.add_argument("--plant-map", type=Path, metavar="FILE", help=about)
    about = "with --plant bridge: do not adapt to wrong numbers of the rig file while it runs"
    parser.add_argument("--no-adaptation", dest="adaptation", action="store_false", help=about)
    parser.add_argument(
        "--end-on-trip",
        action="store_true",
        help="end the run after an emergency stop or a trip; by default the graph stays up until the rig is enabled again, but"
        " not after a trip of a simulated rig without a terminal",
    )
    parser.add_argument(
        "--continue",
        dest="continued",
        type=Path,
        metavar="RUN",
        help="run folder of an interrupted programme: continue it from its load cycle, in its log",
    )
    parser.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap", help="format of the bag")


def run(options: Namespace) -> int:
    """Run it."""
    if options.plant != "sim" and options.in_process:
        raise BadInput("--plant bridge was given", "command line", "--plant sim with --in-process: a rig needs the graph")
    if options.compose and options.in_process:
        raise BadInput("--compose was given", "command line", "no --in-process with it, which starts no nodes")
    check_duration(options)
    spec = load_spec(options.spec)
    if options.duration is not None:
        spec = spec._replace(settings=spec.settings._replace(duration=options.duration))
    return carry_out(spec, options, str(options.spec), ("experiment", str(options.spec)))


def carry_out(spec: Spec, options: Namespace, where: str, command: Sequence[str], *, until_finished: bool = False) -> int:
    """Run an experiment, evaluate it and print the result; return the exit code.

    Args:
        spec: the experiment.
        options: those of :func:`arguments`.
        where: its file, for errors.
        command: words of the command line that names the experiment, without the options.
        until_finished: whether the run ends with its programme, whatever the duration.

    Raises:
        BadInput: the options do not fit the experiment.
    """
    check_plant(options)
    if options.plant_fmu is not None and options.plant != "sim":
        raise BadInput("--plant-fmu was given", "command line", "no --plant bridge with it")
    if options.plant_map is not None and options.plant_fmu is None:
        raise BadInput("--plant-map was given", "command line", "--plant-fmu with it")
    if options.continued is not None:
        _check_continued(options, spec)
    remarks: tuple[str, ...] = ()
    if options.plant == "sim" and (simulated := for_simulated_rig(spec)) is not spec:
        law = spec.controller.name
        remarks = (f"{law} assumes no command delay instead of its default, as the simulated rig has no effect command_delay",)
        spec = simulated
    if options.plant == "bridge":
        spec, remarks = for_real_rig(spec, adapt=options.adaptation)
    if not options.in_process:
        bridge = bridge_at(options.bridge) if options.plant == "bridge" else None
        remarks += check_fit(spec, Graph(bridge=bridge, lockstep=options.timing == "lockstep"), where)
    for remark in remarks:
        print(f"remark: {remark}")
    # Reject an unusable companion file before anything is written or started.
    learnt_files.recall(company_of(spec, model_of(spec.controller_rig, spec.settings.control_period), where), spec)
    folder = RunFolder.create(options.out, Path(where).stem, overwrite=options.overwrite)
    with folder.filling():
        folder.write_spec(spec)
        announce_compiling(loop_jobs(spec) if options.in_process else graph_jobs(spec), what=spec.settings.title)
        with progress_bar(spec.settings.title) as progress:
            if options.in_process:
                done = _in_process(spec, folder, options, progress)
            else:
                done = _over_dds(spec, folder, options, progress, command, until_finished=until_finished)
        metrics = with_causal_limit(evaluate(done.trajectory), done.trajectory)
        metrics = metrics._replace(wall_s=done.wall_s, bag=str(folder.bag), report=str(folder.report))
        metrics = with_failure(metrics, done.failure)
        found = adapted(spec, done.trajectory)
        limited = () if found is None else found.at_bounds
        stops = stops_of(folder.bag, done.trajectory)
        unpaced = ignored_pacing(spec) if options.in_process else ()
        doubts = (*undeclared_effects(spec), *swinging_actuator(spec), *limited, *stops, *unpaced)
        metrics = metrics._replace(warnings=(*metrics.warnings, *doubts))
        folder.write_metrics(metrics)
        write_experiment_report(done.trajectory, metrics, folder.report, read_events(folder.bag))
        lines = () if found is None else _write_adapted(found, folder)
    _print(spec, metrics, done.trajectory, lines, machine=options.json)
    if done.failure is not None:
        raise done.failure
    return 0


def _write_adapted(found: Adapted, folder: RunFolder) -> tuple[str, ...]:
    """Write the rig file with the adapted values, if there is anything to change; return the lines for the user."""
    text = found.text()
    if text:
        folder.rig_adapted.write_text(text, encoding="utf-8")
    where = (
        f"rig file with that                {folder.rig_adapted}"
        if text
        else "rig file                          nothing to change"
    )
    return (*found.sentences, where)


class _Done(NamedTuple):
    """A run, and the reason for its failure if any; its results are kept in any case."""

    trajectory: Trajectory
    wall_s: float
    failure: RunFailed | None = None


def _in_process(spec: Spec, folder: RunFolder, options: Namespace, progress: Callable[[int, int], None]) -> _Done:
    start = time.perf_counter()
    if options.plant_fmu is None:
        trajectory, failure = run_as_far_as_it_goes(spec, progress)
    else:
        trajectory, failure = run_on_fmu(spec, options.plant_fmu, options.plant_map, progress)
    wall = time.perf_counter() - start
    write_trajectory(folder.bag, trajectory, options.storage)
    return _Done(trajectory, wall, failure)


def _over_dds(
    spec: Spec,
    folder: RunFolder,
    options: Namespace,
    progress: Callable[[int, int], None],
    command: Sequence[str],
    *,
    until_finished: bool,
) -> _Done:
    with needs_ros("; or --in-process"):
        from ehls_ros.nodes.graph import Plant, run_graph
    plant = Plant(options.plant, options.bridge)
    if options.plant_fmu is not None:
        # An unusable FMU is reported here, before any node starts.
        fmu_plant(spec, options.plant_fmu, options.plant_map).close()
        plant = Plant("fmu", fmu=options.plant_fmu, plant_map=options.plant_map)
    failure = None
    try:
        wall = run_graph(
            spec,
            folder,
            options.timing,
            options.storage,
            progress,
            plant,
            compose=options.compose,
            end_on_trip=options.end_on_trip,
            # Nobody would ever enable the simulated rig of a script.
            attended=options.plant == "bridge" or sys.stdin.isatty(),
            continued=options.continued,
            until_finished=until_finished,
            say=lambda line: print(line, flush=True),
        )
    except NodeFailed as error:
        wall, failure = error.wall_s, error
    except KeyboardInterrupt:
        if folder.bag.exists():
            print(f"the recording so far is kept in {folder.bag}", file=sys.stderr)
        raise
    finally:
        _print_continuation(spec, options, folder, command)
    return _Done(read_bag(folder.bag), wall, failure)


def _check_continued(options: Namespace, spec: Spec) -> None:
    """Check that ``--continue`` names the folder of a programme, and that the run does not replace it.

    Raises:
        BadInput: it does not.
    """
    folder = options.continued
    if spec.reference.name != "programme" or options.in_process:
        raise BadInput("--continue was given", "command line", "an experiment whose reference is a programme, over DDS")
    if read_state(folder) is None:
        raise BadInput(f"there is no {STATE}", str(folder), "the run folder of an interrupted programme")
    if options.out is not None and options.out.resolve() == folder.resolve():
        raise BadInput("--out and --continue name one folder", "command line", "another folder for this run's recording")


def _print_continuation(spec: Spec, options: Namespace, folder: RunFolder, command: Sequence[str]) -> None:
    """Print how to continue a programme that has not finished, from its load cycle."""
    records = options.continued or folder.path
    if spec.reference.name != "programme" or not (records / STATE).exists():
        return
    try:
        state = read_state(records)
    except BadInput:
        return  # the programme node has reported it
    total = programme_of(spec.reference.parameters).load_cycles
    if state is None or state.counted >= total:
        return
    words = ["ehls", *command, "--plant", options.plant]
    words += ["--bridge", str(options.bridge)] if options.bridge else []
    words += ["--timing", options.timing, *(["--compose"] if options.compose else []), "--continue", str(records)]
    print(f"  programme at load cycle {state.counted} of {total}; to continue: {shlex.join(words)}", flush=True)


def _print(spec: Spec, metrics: Metrics, trajectory: Trajectory, found: tuple[str, ...], *, machine: bool) -> None:
    wall = metrics.wall_s or float("nan")
    print(f"{spec.settings.title}")
    position_error = 1e3 * steady_error(trajectory, "position_m", "position_reference_m")
    if position_error.size:
        print(f"  largest error in the last half  {position_error.max():10.3f} mm")
        print(f"  rms error in the last half      {math.sqrt((position_error**2).mean()):10.3f} mm")
    else:
        match metrics.convergence_s:
            case None:
                convergence = "not converged"
            case 0.0:
                convergence = "from the start"
            case seconds:
                convergence = f"after {seconds:.2f} s"
        print(f"  largest error in the last half  {metrics.max_error_n:10.1f} N")
        print(f"  causal limit of it              {limit_text(metrics.causal_limit_n):>10}")
        print(f"  rms error in the last half      {metrics.rms_error_n:10.1f} N")
        print(f"  convergence                     {convergence:>12}")
        of_reference = f"{100.0 * CONVERGENCE_BAND:g} % of the largest reference"
        print(f"  convergence band                {metrics.convergence_band_n:10.1f} N, {of_reference}")
        if metrics.convergence_s is None:
            print(f"  oscillation in the last half    {metrics.oscillation_n:10.1f} N to either side")
    print(f"  cycles, unanswered ones         {metrics.cycles:8d}, {metrics.missed_cycles}")
    print(f"  wall time                       {wall:10.2f} s ({number(metrics.duration_s / wall, 2)} x real time)")
    if metrics.in_real_time is not None:
        kept = "yes" if metrics.in_real_time else "NO"
        pace = f"{metrics.cycles_per_second_reached:.0f} of {metrics.cycles_per_second_asked:.0f} cycles/s"
        print(f"  in real time                    {kept:>10}: {pace}")
    if metrics.in_real_time is False:
        print(f"  too slow for real time: {ADVICE}")
    print(f"  bag                             {metrics.bag}")
    print(f"  report                          {metrics.report}")
    for sentence in found:
        print(f"  {sentence}")
    for warning in metrics.warnings:
        print(f"  warning: {warning}")
    sys.stdout.flush()
    if machine:
        print(json.dumps(json_document(metrics)))
