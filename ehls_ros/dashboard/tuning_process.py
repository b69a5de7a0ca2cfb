"""Tuning of a law in a separate process, on one processor.

`python -m ehls_ros.dashboard.tuning_process FOLDER LAW PARENT` tunes a law for the experiment in a run folder. It prints its
progress and at last its result, a JSON document of a :class:`Report` per line, and ends with its parent.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ehls_ros.dashboard.graph import TunedNumber, TuningPoint, TuningResult
from ehls_ros.errors import BadInput
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import Spec, load_spec, spec_to_mapping
from ehls_ros.experiments.tuning.task import Task, task_of
from ehls_ros.experiments.tuning.tune import Trial, Tuned, tunable, tune
from ehls_ros.process import end_with
from ehls_ros.report.tuning import sentence, write_tuning_files
from ehls_ros.schema import notes


class Report(NamedTuple):
    """Progress of a tuning, or its result.

    Attributes:
        done: number of sets of numbers tried.
        most: largest number of sets to be tried.
        result: the result, in the last report.
    """

    done: int = 0
    most: int = 0
    result: TuningResult | None = None


def task_for(spec: Spec, law: str, where: str) -> Task:
    """Return what is tuned for: an experiment on the rig that its controller knows, without effects hidden from it.

    Args:
        spec: the experiment.
        law: law to tune.
        where: name or file of the experiment, for errors.

    Raises:
        BadInput: the law has no numbers to tune, or it or the experiment does not follow a force.
    """
    tunable(law)
    return task_of(spec.controller_rig, law, spec_to_mapping(spec), where)


def result_of(found: Tuned) -> TuningResult:
    """Return a result as the page shows it; the numbers are rounded as in the parameter file."""
    declared = notes(type(found.spec.controller.parameters))
    return TuningResult(
        sentence=sentence(found),
        holds=found.holds,
        lost=found.lost,
        numbers=tuple(
            TunedNumber(
                name, declared[name].unit, declared[name].description, default, float(f"{found.chosen.numbers[name]:.6g}")
            )
            for name, default in found.default.numbers.items()
        ),
        default=_point(found.default),
        found=_point(found.chosen),
        curve=tuple(map(_point, found.curve)),
        wanted_db=found.wanted.gain_db,
        causal_limit=found.causal_limit,
        remarks=found.remarks,
    )


def main(words: Sequence[str]) -> int:
    """Tune, and write the files into the folder.

    Args:
        words: run folder with the experiment, law, and id of the parent process.

    Returns:
        The exit code; if it is not 0, the last line printed is the reason.
    """
    folder, law, parent = words
    end_with(int(parent))
    run = RunFolder(Path(folder))
    try:
        found = tune(task_for(load_spec(run.spec), law, str(run.spec)), jobs=1, progress=lambda *steps: _print(Report(*steps)))
    except BadInput as error:
        sys.stdout.write(f"{error}\n")
        return 1
    write_tuning_files(found, run.path)
    _print(Report(result=result_of(found)))
    return 0


def _point(trial: Trial) -> TuningPoint:
    return TuningPoint(trial.error, trial.gain_db, trial.margins.phase_deg, trial.held)


def _print(report: Report) -> None:
    sys.stdout.write(f"{json.dumps(json_document(report))}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
