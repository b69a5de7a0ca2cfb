"""`ehls campaign`: many experiments from one file, on this machine's processors or on a Dask cluster."""

import json
import os
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from ehls_ros.cli.arguments import add_configured, add_json, check_range
from ehls_ros.experiments.campaign.backends import dask, local
from ehls_ros.experiments.campaign.conduct import Outcome, conduct
from ehls_ros.experiments.campaign.plan import Plan, load_plan
from ehls_ros.experiments.campaign.results import CampaignResults, Summary, quantile, results_of
from ehls_ros.experiments.campaign.store import Folder, opened, read_results
from ehls_ros.experiments.campaign.work import code_version
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.yaml_files import spec_text
from ehls_ros.progress import duration_text, progress_bar
from ehls_ros.report.campaign import write_campaign_report
from ehls_ros.report.campaign_findings import verdict_sentence

HELP = "Run a sweep or a Monte Carlo study of experiments: one table of metrics and a report. A second start continues."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    add_configured(parser, "campaign", "campaigns", "campaign file (YAML), or a name such as k_and_h")
    parser.add_argument("--out", type=Path, help="folder of the results (default: runs/<campaign>)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=int, help="number of processes (default: one per processor)")
    where.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, such as tcp://192.168.0.7:8786")
    parser.add_argument("--spec", type=int, metavar="RUN", help="print the spec of one run of the table, and stop")
    add_json(parser, "the summary")


def run(options: Namespace) -> int:
    """Run it."""
    check_range(options, "jobs", 1)
    plan = load_plan(options.campaign)
    if options.spec is not None:
        print(spec_text(json.loads(plan.run(options.spec).spec)), end="")
        return 0
    place = dask(options.dask) if options.dask else local(options.jobs or len(os.sched_getaffinity(0)))
    with opened(options.out or Path("runs") / options.campaign.stem) as folder:
        try:
            with progress_bar(plan.settings.title) as progress:
                outcome = conduct(plan, folder, place, progress)
        except KeyboardInterrupt:
            print(f"finished runs are kept in {folder.parts}; start again to continue", file=sys.stderr)
            raise
        results = results_of(plan.columns, read_results(folder.results))
        making = [
            ("Runs", str(outcome.runs)),
            ("Made by the last call", str(outcome.made)),
            ("Wall time of the last call", duration_text(outcome.wall_s)),
            ("Seed", str(plan.settings.seed)),
            ("ehls_ros", code_version()),
        ]
        write_campaign_report(results, plan.file, making, folder.report)
    _print(plan, folder, outcome, results, machine=options.json)
    return 0


def _print(plan: Plan, folder: Folder, outcome: Outcome, results: CampaignResults, *, machine: bool) -> None:
    print(plan.settings.title)
    print(f"  {verdict_sentence(results)[0]}")
    print(f"  made now     {outcome.made} of {outcome.runs} runs in {duration_text(outcome.wall_s)}")
    print(f"  table        {folder.results}")
    print(f"  report       {folder.report}")
    if machine:
        errors = results.max_error_n
        summary = Summary(
            outcome.runs,
            outcome.made,
            failed=len(results.failed),
            not_converged=len(results.not_converged),
            median_max_error_n=quantile(errors, 0.5),
            p95_max_error_n=quantile(errors, 0.95),
            largest_max_error_n=quantile(errors, 1.0),
            wall_s=outcome.wall_s,
            results=str(folder.results),
            report=str(folder.report),
        )
        print(json.dumps(json_document(summary)))
