"""`ehls diagnose`: what the simulation gets wrong, from a recording of the rig."""

import json
import os
import shutil
import sys
import tempfile
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.table import Table

from ehls_ros import __version__
from ehls_ros.cli.folder import writable
from ehls_ros.cli.progress import progress_bar
from ehls_ros.cli.valid_json import valid_json
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.result import Cause, Diagnosis
from ehls_ros.errors import BadInput
from ehls_ros.experiments.diagnosis import Consequences, consequences
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.load import load
from ehls_ros.report.diagnosis import Beside, write_diagnosis_report
from ehls_ros.report.diagnosis_findings import verdict_sentence
from ehls_ros.report.diagnosis_units import estimate, likely, part
from ehls_ros.trajectory import Trajectory

HELP = "Find what the simulation of a rig gets wrong, from a recording: diagnosis.json, a report, the rig file extended."

RESULT, REPORT, RIG, NEXT = "diagnosis.json", "report.html", "rig_extended.yaml", "next_experiment.yaml"
"""What the folder receives; the last where an experiment is proposed."""

CORE, WHOLE = 0.8, 1000
"""Part of the time that the diagnosis itself takes; length of the progress bar."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "data", type=Path, nargs="+", metavar="DATA", help="one recording: a bag, a run folder, a .csv, .mat or .parquet file"
    )
    parser.add_argument("--rig", type=Path, required=True, help="rig file that the simulation runs with")
    parser.add_argument("--columns", type=Path, help="YAML that maps the file's own column names and units")
    parser.add_argument("--out", type=Path, default=Path("runs/diagnose"), help="folder of the results (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of noise and resampling (%(default)s)")
    parser.add_argument("--threads", type=int, help="hypotheses tried at once (default: one a processor)")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON: diagnosis.json")


def run(options: Namespace) -> int:
    """Run it."""
    if len(options.data) > 1:
        names = ", ".join(str(path) for path in options.data)
        raise BadInput(f"{len(options.data)} recordings are given ({names})", "command line", "one; diagnose them one by one")
    if options.threads is not None and options.threads < 1:
        raise BadInput(f"--threads is {options.threads}", "command line", "1 or more")
    if options.seed < 0:
        raise BadInput(f"--seed is {options.seed}", "command line", "0 or more")
    [data] = options.data
    began = time.perf_counter()
    rig = load_rig(options.rig)
    columns = read_columns(options.columns) if options.columns else None
    folder = writable(options.out, RESULT)
    name = data.name or str(data)
    with progress_bar("diagnosing") as bar:
        bar(0, WHOLE, "reading")
        bag = data / "bag"
        trajectory = load(bag if bag.is_dir() else data, columns)
        found = diagnose(
            trajectory,
            rig,
            name,
            seed=options.seed,
            threads=options.threads,
            progress=lambda doing, done: bar(round(CORE * WHOLE * done), WHOLE, doing),
        )
        follows = consequences(
            found,
            trajectory,
            name,
            progress=lambda doing, done: bar(round(WHOLE * (CORE + (1.0 - CORE) * done)), WHOLE, doing),
        )
        result = valid_json(as_json(found, follows, time.perf_counter() - began))
        _write(folder, found, follows, result, options.rig, _source(data, options.rig, trajectory))
    _print(found, follows, folder, time.perf_counter() - began)
    if options.json:
        print(json.dumps(result))
    return 0


def _source(data: Path, rig: Path, trajectory: Trajectory) -> str:
    seconds = float(trajectory.time_s[-1] - trajectory.time_s[0])
    return f"{data.name or data}, {seconds:.4g} s, {len(trajectory)} samples, against {rig.name}"


# --- results -----------------------------------------------------------------------------------


def as_json(found: Diagnosis, follows: Consequences, wall: float) -> dict[str, Any]:
    """Return what ``diagnosis.json`` holds; ``wall`` is the time all of it took [s]."""
    proposal = follows.proposal
    run = follows.free_run
    return {
        "verdict": found.verdict,
        "summary": verdict_sentence(found)[0],
        "stages": {
            stage: {**result._asdict(), "depends_on": list(result.depends_on)} for stage, result in found.stages.items()
        },
        "causes": [_cause(cause) for cause in found.causes] or _unknown(found),
        "depends_on": list(found.depends_on),
        "gain": _gain(found),
        "next_experiment": proposal.experiment.as_json() if proposal is not None and proposal.experiment is not None else None,
        "extended_rig": RIG,
        "seed": found.seed,
        "version": __version__,
        "unknown_stage": found.unknown_stage,
        "partial": list(found.partial),
        "missing": list(found.missing),
        "not_judged": dict(found.not_judged),
        "sensitivities": [item._asdict() for item in found.sensitivities],
        "controller_gain": follows.controller.as_json() if follows.controller is not None else None,
        "free_run": None
        if run is None
        else {
            "seconds": float(run.time[-1]),
            "nrmse": {s.name: {"before": s.nrmse_before, "after": s.nrmse_after} for s in run.signals},
            "remarks": list(run.remarks),
        },
        "remarks": [*found.remarks, *follows.remarks, *_no_experiment(follows)],
        "diagnosis_s": found.wall_s,
        "wall_s": wall,
    }


def _no_experiment(follows: Consequences) -> list[str]:
    proposal = follows.proposal
    return [f"no next experiment: {proposal.reason}"] if proposal is not None and proposal.experiment is None else []


def _cause(cause: Cause) -> dict[str, Any]:
    effect = EFFECTS.load(cause.name)
    return {
        "name": cause.name,
        "probability": cause.probability,
        "equivalent_to": list(cause.equivalent_to),
        "stage": cause.stage,
        "group": cause.group,
        "parameters": {name: e._asdict() for name, e in cause.parameters.items()},
        "fixed": dict(cause.fixed),
        "evidence": {
            "gain_nats": cause.gain,
            "standard_errors_from_neutral": cause.sigmas,
            "equation": effect.EQUATION,
            "rivals": [
                {
                    "name": rival.name,
                    "behind_nats": rival.behind,
                    "closed_fraction": rival.closed_fraction,
                    "parameters": {name: e._asdict() for name, e in rival.parameters.items()},
                }
                for rival in cause.rivals
            ],
        },
    }


def _unknown(found: Diagnosis) -> list[dict[str, Any]]:
    """Return the one entry that stands for a cause no effect is."""
    if found.verdict != "unknown" or found.unknown_stage is None:
        return []
    result = found.stages[found.unknown_stage]
    return [
        {
            "name": "unknown",
            "probability": 1.0,
            "equivalent_to": [],
            "stage": found.unknown_stage,
            "parameters": {},
            "evidence": {
                "depends_on": list(found.depends_on),
                "partial": list(found.partial),
                "nrmse": result.nrmse_after,
                "noise_floor": result.noise_floor,
            },
        }
    ]


def _gain(found: Diagnosis) -> dict[str, Any]:
    """Return the gain; without an extension, of the stage that stands out most, with nothing gained."""
    gain = found.gain
    if gain is not None:
        return {**gain._asdict(), "ci95": list(gain.ci95)}
    judged = [result for result in found.stages.values() if result.judged and result.nrmse_before is not None]
    if found.unknown_stage is not None:
        judged = [found.stages[found.unknown_stage]]
    worst = max(judged, key=lambda r: (r.nrmse_before or 0.0) / max(r.noise_floor or 0.0, 1e-300), default=None)
    before = None if worst is None else worst.nrmse_before
    return {
        "channel": None,
        "heldout_nrmse_before": before,
        "heldout_nrmse_after": before,
        "noise_floor": None if worst is None else worst.noise_floor,
        "closed_fraction": 0.0 if found.verdict == "unknown" else None,
        "ci95": [0.0, 0.0] if found.verdict == "unknown" else [None, None],
    }


def _write(folder: Path, found: Diagnosis, follows: Consequences, result: Mapping[str, Any], rig: Path, source: str) -> None:
    """Write all results beside the folder's and then put them in their places, so that an interruption leaves no halves."""
    proposal = follows.proposal
    experiment = None if proposal is None else proposal.experiment
    beside = Beside(
        source=source,
        free_run=follows.free_run,
        controller=result["controller_gain"],
        next_experiment=result["next_experiment"],
        no_experiment=proposal.reason if proposal is not None else "",
        remarks=follows.remarks,
    )
    scratch = Path(tempfile.mkdtemp(prefix=".diagnose-", dir=folder))
    try:
        (scratch / RESULT).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
        (scratch / RIG).write_text(_rig_file(found, rig, source), encoding="utf-8")
        write_diagnosis_report(found, scratch / REPORT, beside)
        if experiment is not None:
            spec = {**experiment.spec, "rig": RIG, "controller_rig": os.path.relpath(rig, folder)}
            (scratch / NEXT).write_text(_next_heading(experiment.purpose) + _yaml(spec), encoding="utf-8")
        else:
            (folder / NEXT).unlink(missing_ok=True)
        for file in sorted(scratch.iterdir()):
            file.replace(folder / file.name)
    except OSError as error:
        raise BadInput(f"the results cannot be written ({error.strerror})", str(folder), "a writable folder") from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _yaml(mapping: Mapping[str, Any]) -> str:
    text: str = yaml.safe_dump(json.loads(json.dumps(mapping)), sort_keys=False, allow_unicode=True)
    return text


def _rig_file(found: Diagnosis, rig: Path, source: str) -> str:
    """Return the extended rig file; without an extension, the rig file as it was, comments included."""
    heading = f"# Written by `ehls diagnose` from {source}.\n"
    if found.extended == found.rig:
        return f"{heading}# Nothing was added: the verdict is '{found.verdict}'.\n{rig.read_text(encoding='utf-8')}"
    added = "".join(
        f"#   {cause.name}: {', '.join(f'{name} {estimate(e)}' for name, e in cause.parameters.items())};"
        f" probability {likely(cause.probability)}"
        f"{', or ' + ' or '.join(cause.equivalent_to) if cause.equivalent_to else ''}\n"
        for cause in found.causes
    )
    return f"{heading}# Added at the end of `effects`:\n{added}{_yaml(rig_to_mapping(found.extended))}"


def _next_heading(purpose: str) -> str:
    return f"# Proposed by `ehls diagnose`, to tell apart the causes it left open: {purpose}.\n"


# --- terminal ----------------------------------------------------------------------------------


def _print(found: Diagnosis, follows: Consequences, folder: Path, wall: float) -> None:
    print(verdict_sentence(found)[0])
    console = Console(file=sys.stdout, width=None if sys.stdout.isatty() else 140)
    if found.causes:
        console.print(_causes_table(found.causes))
    for sentence in found.missing if found.verdict == "insufficient" else ():
        print(f"  {sentence}")
    gain = found.gain
    if gain is not None:
        low, high = gain.ci95
        print(
            f"held-out NRMSE {part(gain.heldout_nrmse_before)} -> {part(gain.heldout_nrmse_after)}, noise"
            f" {part(gain.noise_floor)}; {part(gain.closed_fraction)} of the removable error is gone"
            f" ({part(low)} to {part(high)})"
        )
    proposal = follows.proposal
    if proposal is not None and proposal.experiment is not None:
        print(f"next experiment: {proposal.experiment.name}, {proposal.experiment.purpose}")
    for remark in (*found.remarks, *follows.remarks, *_no_experiment(follows)):
        print(f"  {remark}")
    print(f"wall time {wall:.1f} s, of which diagnosis {found.wall_s:.1f} s")
    print(f"  result  {folder / RESULT}")
    print(f"  report  {folder / REPORT}")
    print(f"  rig     {folder / RIG}")
    if proposal is not None and proposal.experiment is not None:
        print(f"  next    {folder / NEXT}")


def _causes_table(causes: Sequence[Cause]) -> Table:
    table = Table(title="Causes")
    table.add_column("cause", no_wrap=True)
    table.add_column("probability", justify="right")
    table.add_column("parameter")
    table.add_column("value ± error", justify="right", no_wrap=True)
    equivalents = any(cause.equivalent_to for cause in causes)
    if equivalents:
        table.add_column("or else")
    for cause in causes:
        said = [cause.name, likely(cause.probability)]
        others = [", ".join(cause.equivalent_to)] if equivalents else []
        for name, e in cause.parameters.items():
            table.add_row(*said, name, estimate(e), *others)
            said, others = ["", ""], [""] * len(others)
    return table
